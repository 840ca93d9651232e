"""The command line `dropper`: commands are found by the entry-point group `dropper.commands`.

A command is imported only when it is used, and imports JAX after it has checked its arguments and files. Imports inside
functions are allowed only here and in the root of the package. Each run is compiled to one kernel, and programs are
cached for the next start. With `--json` each command prints exactly one object on standard output, for every exit code.
"""

from __future__ import annotations

import gc
import os
import sys
import textwrap
from argparse import SUPPRESS, Action, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import NoReturn, Protocol

from dropper_jax import backend
from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import by_name
from dropper_jax.cli.faults import close_stdout, report_error, terminated_as_interrupted, with_streams
from dropper_jax.cli.printing import OK

#: XLA's own messages, such as "Very slow compile? ... file a bug", are for its developers: only fatal ones are shown.
XLA_LOG = "TF_CPP_MIN_LOG_LEVEL"
FATAL = "3"


GROUP = "dropper.commands"
PACKAGES = ("dropper-jax", "jax")
HELP = ("-h", "--help")
#: Commands by what they are for, those in frequent use first. Commands of other packages follow under `Others`.
GROUPS = {
    "Simulate": ("new", "check", "run", "equilibrium", "explain", "view", "report", "scenes", "demo", "library"),
    "Sea and farm": ("sea", "cases", "optimise", "design", "season", "growth"),
    "Fit and design of experiments": ("track", "fit", "plan"),
    "Studies": ("sweep", "sensitivity", "modes", "stiffness", "offset", "response", "frequency"),
    "Checks": ("doctor", "accuracy", "cost", "stability"),
}
OTHERS = "Others"


def prepare() -> None:
    """Settings of a process that only runs commands, before JAX is imported."""
    # allocations between two garbage collections: tracing makes millions of lasting objects, and with Python's default
    # (700) the collector takes 10 % of the time
    gc.set_threshold(100_000, 50, 100)
    os.environ.setdefault(XLA_LOG, FATAL)
    backend.stores_programs = True


class Command(Protocol):
    """The object of an entry point, usually a module; the name of the entry point is that of the command.

    Attributes:
        help: one line of help.
    """

    help: str

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Declare the arguments, without heavy imports."""

    def run(self, args: Namespace) -> int:
        """Run the command; returns an exit code of `dropper_jax.cli.printing`."""


class _Parser(ArgumentParser):
    """A parser with one-line errors, like those of all other invalid input."""

    def error(self, message: str) -> NoReturn:
        raise SceneError(f"{self.prog}: {' '.join(message.split())}")


class _Version(Action):
    """Print versions and stop; they are looked up only if requested."""

    def __call__(self, parser: ArgumentParser, *_: object) -> NoReturn:
        print("\n".join(f"{package} {_version_of(package)}" for package in PACKAGES))
        parser.exit()


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def find_commands() -> list[EntryPoint]:
    """All commands, by name."""
    return sorted(entry_points(group=GROUP), key=lambda entry: entry.name)


def parse(argv: Sequence[str]) -> Namespace:
    """Arguments of a command, with its `run`.

    Raises:
        SceneError: invalid arguments, or a command that cannot be imported.
    """
    # every option in front of the command ends the program, so the first other word is the command
    asked = next((word for word in argv if not word.startswith("-")), None)
    listed = asked is None and (not argv or any(word in HELP for word in argv))
    about = "Simulate mussel droppers, pendulums and strings.\ndropper COMMAND --help: its options and two examples."
    plain = RawDescriptionHelpFormatter
    parser = _Parser(prog="dropper", description=about, formatter_class=plain, allow_abbrev=False)
    parser.add_argument("--version", action=_Version, nargs=0, help=f"print the versions of {' and '.join(PACKAGES)}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", help=SUPPRESS)
    found = find_commands()
    if asked and not found:  # the packages are on the path but not installed, so that nothing declares their commands
        raise SceneError("dropper: no commands; needed: pip install dropper-jax, or pip install -e . in a checkout")
    for entry in found:
        own = commands.add_parser(entry.name)
        if entry.name == asked:
            command = _load(entry)
            own.description, own.formatter_class = command.help, plain
            command.add_arguments(own)
            own.set_defaults(run=command.run)
    if listed:
        parser.epilog = grouped_commands()
    return parser.parse_args(argv or [HELP[0]])


def command_groups() -> dict[str, list[EntryPoint]]:
    """All commands by group."""
    left = by_name(find_commands())
    found = {}
    for group, names in GROUPS.items():
        found[group] = [left.pop(name) for name in names if name in left]
    found[OTHERS] = list(left.values())
    return {group: entries for group, entries in found.items() if entries}


def grouped_commands() -> str:
    """The commands by group, each with its line of help."""
    # columns of the names in the list of commands
    names = 15
    lines: list[str] = []
    for group, entries in command_groups().items():
        lines += ["", group]
        for entry in entries:
            head = f"  {entry.name}".ljust(names)
            lines += textwrap.wrap(head + _help(entry), 100, subsequent_indent=" " * names, drop_whitespace=True)
    return "\n".join(lines[1:])


def _load(entry: EntryPoint) -> Command:
    try:
        return entry.load()
    except ImportError as error:
        raise SceneError(f"dropper {entry.name}: is not available: {error}") from None


def _help(entry: EntryPoint) -> str:
    try:
        return _load(entry).help
    except SceneError as error:
        return str(error)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    if argv is None:
        argv = sys.argv[1:]
    with_streams()
    prepare()
    with terminated_as_interrupted():
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
