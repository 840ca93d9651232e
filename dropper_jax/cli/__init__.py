"""The command line `dropper`: commands are found by the entry-point group `dropper.commands`.

A command is imported when it is asked for, and imports JAX when its arguments and files have been looked at; only
here and in the package's root may imports stand inside functions. Runs are compiled to one kernel each, and
programs are kept for the next start. With `--json`
each command prints exactly one object on standard output, whatever the exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from dropper_jax.cli.before_jax import prepare
from dropper_jax.cli.codes import OK
from dropper_jax.cli.commands import parse
from dropper_jax.cli.faults import close_stdout, report_error, terminated_as_interrupted, with_streams


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    with_streams()
    prepare()
    with terminated_as_interrupted():
        try:
            args = parse(argv)
            code = args.run(args)
            sys.stdout.flush()
            return code
        except BrokenPipeError:  # `dropper scenes | head`: the reader has what it wanted
            close_stdout()
            return OK
        except (Exception, KeyboardInterrupt) as error:
            return report_error(error, "--json" in argv)
        except SystemExit:  # --help and --version
            try:
                sys.stdout.flush()
            except OSError as error:
                return report_error(error, False)
            raise
