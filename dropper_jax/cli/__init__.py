"""The command line `dropper`: commands are found by the entry-point group `dropper.commands`.

A command is imported when it is asked for, and imports JAX when its arguments and files have been looked at; only
here and in the package's root may imports stand inside functions. Runs are compiled to one kernel each, and
programs are kept for the next start. With `--json`
each command prints exactly one object on standard output, whatever the exit code.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.before_jax import prepare
from dropper_jax.cli.codes import INTERRUPTED, INVALID_INPUT, OK
from dropper_jax.cli.commands import parse
from dropper_jax.cli.output import failure_object, print_json, print_line


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = "--json" in argv
    prepare()
    try:
        args = parse(argv)
        code = args.run(args)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # `dropper scenes | head`: the reader has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains as it flushes at the end
        return OK
    except (SceneError, OSError) as error:
        return _stop("invalid_input", str(error), INVALID_INPUT, as_json)
    except KeyboardInterrupt:
        return _stop("interrupted", "interrupted", INTERRUPTED, as_json)


def _stop(status: str, message: str, code: int, as_json: bool) -> int:
    message = " ".join(message.split())
    print_line(f"error: {message}")
    if as_json:
        print_json(failure_object(status, message))
    return code
