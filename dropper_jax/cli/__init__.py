"""The command line `dropper`: commands are found by the entry-point group `dropper.commands`.

A command is a module or object with `name`, `help`, `add_arguments(parser)` and `run(args) -> int`, an exit code of
`dropper_jax.cli.codes`. With `--json` each prints exactly one object on standard output, whatever the exit code.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any, NoReturn

from dropper_jax.base.errors import SceneError
from dropper_jax.cli.codes import INTERRUPTED, INVALID_INPUT, OK
from dropper_jax.cli.output import failure_object, print_json, print_line

GROUP = "dropper.commands"


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other invalid input."""

    def error(self, message: str) -> NoReturn:
        raise SceneError(f"{self.prog}: {' '.join(message.split())}")


def _commands() -> dict[str, Any]:
    found = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            found[entry.name] = entry.load()
        except ImportError as error:
            print_line(f"warning: command {entry.name!r} is not available: {error}")
    return found


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="dropper", description="Simulate mussel droppers, pendulums and strings.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _commands().values():
        sub = commands.add_parser(command.name, help=command.help, description=command.help)
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = "--json" in argv
    try:
        args = _parser().parse_args(argv)
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
