"""The commands: found by their entry points and imported when used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import NoReturn, Protocol

from dropper_jax.base.errors import SceneError

GROUP = "dropper.commands"
PACKAGES = ("dropper-jax", "jax")
HELP = ("-h", "--help")


class Command(Protocol):
    """The object of an entry point, usually a module; the name of the entry point is that of the command.

    Attributes:
        help: one line of help.
    """

    help: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments, without heavy imports."""

    def run(self, args: argparse.Namespace) -> int:
        """Run the command; returns an exit code of `dropper_jax.cli.codes`."""


class _Parser(argparse.ArgumentParser):
    """A parser with one-line errors, like those of all other invalid input."""

    def error(self, message: str) -> NoReturn:
        raise SceneError(f"{self.prog}: {' '.join(message.split())}")


class _Version(argparse.Action):
    """Print versions and stop; they are looked up only if requested."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
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


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Arguments of a command, with its `run`.

    Raises:
        SceneError: invalid arguments, or a command that cannot be imported.
    """
    # every option in front of the command ends the program, so the first other word is the command
    asked = next((word for word in argv if not word.startswith("-")), None)
    listed = asked is None and any(word in HELP for word in argv)
    parser = _Parser(prog="dropper", description="Simulate mussel droppers, pendulums and strings.", allow_abbrev=False)
    parser.add_argument("--version", action=_Version, nargs=0, help=f"print the versions of {' and '.join(PACKAGES)}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for entry in find_commands():
        if entry.name == asked:
            command = _load(entry)
            own = commands.add_parser(entry.name, description=command.help)
            command.add_arguments(own)
            own.set_defaults(run=command.run)
        else:
            commands.add_parser(entry.name, **({"help": _help(entry)} if listed else {}))
    return parser.parse_args(argv)


def _load(entry: EntryPoint) -> Command:
    try:
        return entry.load()
    except ImportError as error:
        raise SceneError(f"dropper {entry.name}: is not available: {error}") from None


def _help(entry: EntryPoint) -> str:
    try:
        return _load(entry).help
    except SceneError as error:
        return str(error).replace("%", "%%")
