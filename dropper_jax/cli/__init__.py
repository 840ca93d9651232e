"""The command line `dropper`: commands are found by the entry-point group `dropper.commands`.

A command is imported only when it is used, and imports JAX after it has checked its arguments and files. Imports inside
functions are allowed only here and in the root of the package. Each run is compiled to one kernel, and programs are
cached for the next start. With `--json` each command prints exactly one object on standard output, for every exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from dropper_jax.cli.commands import parse, prepare
from dropper_jax.cli.faults import (
    close_stdout,
    old_names_in_one_line,
    report_error,
    terminated_as_interrupted,
    with_streams,
)
from dropper_jax.cli.options import OK


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    with_streams()
    prepare()
    with terminated_as_interrupted(), old_names_in_one_line():
        try:
            args = parse(argv)
            code = args.run(args)
            sys.stdout.flush()
            return code
        except BrokenPipeError:  # `dropper scenes | head`: the reader has closed the pipe
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
