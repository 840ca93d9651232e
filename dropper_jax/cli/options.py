"""Arguments that several commands share, and the scenes and runs that they name."""

from __future__ import annotations

import tomllib
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from dropper_jax.base.errors import SceneError, unreadable
from dropper_jax.base.files import leftovers, refuse_pipe
from dropper_jax.base.read import Plain, Table
from dropper_jax.base.references import references_of
from dropper_jax.base.toml_text import parse_toml_text
from dropper_jax.cli.given import AUTO, number, step_length
from dropper_jax.cli.printing import print_line, print_warnings
from dropper_jax.integrators import SCHEMES
from dropper_jax.load.packaged import find_scene, folder_of

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.run.simulate import Solution

SET_HELP = "change a value of the scene, such as effects.linear_damping.b_l=0.01 (may be given several times)"


def add_scene(parser: ArgumentParser, *examples: str, optional: bool = False) -> None:
    """Examples at the end of the help, SCENE, --set and --json."""
    add_examples(parser, *examples)
    what = "name of a packaged scene, a TOML file, a MoorDyn input, or a mooring of MoorPy or RAFT (.yaml)"
    nargs = "?" if optional else None
    parser.add_argument("scene", metavar="SCENE", help=what, nargs=nargs)
    parser.add_argument("--depth", type=number, help="water depth [m] for a MoorDyn input that has none")
    add_allow_outside(parser)
    add_effects(parser)
    add_set(parser)
    add_json(parser)


def add_flag(parser: ArgumentParser, option: str, about: str) -> None:
    """An option that is on or off."""
    parser.add_argument(option, action="store_true", help=about)


def add_effects(parser: ArgumentParser) -> None:
    """--effects."""
    about = "Python file with effects of your own that the scene uses (may be given several times)"
    parser.add_argument("--effects", action="append", default=[], metavar="FILE.py", help=about)


def register_effects(args: Namespace) -> None:
    """Make the effects of installed packages and of `--effects` known; imports JAX."""
    from dropper_jax.effects import register_file, register_installed

    register_installed()
    for file in args.effects:
        register_file(file)


def add_examples(parser: ArgumentParser, *examples: str) -> None:
    """Complete command lines at the end of the help."""
    parser.epilog = "\n".join(["examples:", *(f"  dropper {example}" for example in examples)])


def add_allow_outside(parser: ArgumentParser) -> None:
    """--allow-outside."""
    add_flag(parser, "--allow-outside", "allow the scene to use files outside its folder")


def add_set(parser: ArgumentParser) -> None:
    """--set."""
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=SET_HELP)


def add_run_values(parser: ArgumentParser, keys: Iterable[str]) -> None:
    """An option for each of these keys of `[run]`; `read_scene` puts their values into the scene."""
    for key in keys:
        parser.add_argument(f"--{key.replace('_', '-')}", **RUN_VALUES[key])


def add_json(parser: ArgumentParser) -> None:
    """--json."""
    add_flag(parser, "--json", "print one JSON object on standard output, nothing else")


def add_quiet(parser: ArgumentParser) -> None:
    """--quiet."""
    add_flag(parser, "--quiet", "no progress")


def read_scene(args: Namespace, run_values: Iterable[str] = (), notes: bool = True) -> Scene:
    """The scene with `--set` and options for keys of `[run]`; JAX is imported after the file was found to be TOML.

    Args:
        run_values: these keys.
        notes: print what its source file has and the scene lacks; False if the warnings of the command contain it.
    """
    values = given_values(args, run_values)
    if args.scene is None:
        raise SceneError("SCENE: missing; needed: the name of a packaged scene or a file")
    with references_of(folder_of(args.scene, vars(args).get("allow_outside", True))):
        table, name = find_scene(args.scene, vars(args).get("depth"))

        from dropper_jax.load.scene import Scene

        register_effects(args)
        scene = Scene.from_dict(table, name)
    if notes:
        print_warnings(scene.notes)
    if values:
        scene = scene.with_values(values)
    return with_step(scene, args)


def with_step(scene: Scene, args: Namespace) -> Scene:
    """The scene with the suggested step for `--dt auto`, which is printed."""
    if vars(args).get("dt") != AUTO:
        return scene

    from dropper_jax.load.periods import suggest_step

    step = suggest_step(scene)
    print_line(f"time step: {step:g} s (--dt auto)")
    return scene.with_values({"run.dt": step})


def given_values(args: Namespace, run_values: Iterable[str]) -> Table:
    """Values by path from `--set` and options for these keys of `[run]`."""
    found = assignments(args.set)
    for key in run_values:
        value = getattr(args, key)
        if value not in (None, AUTO):
            found[f"run.{key}"] = value
    return found


def read_run(file: str, args: Namespace) -> Solution:
    """A saved run; JAX is imported after the file, or the rest of a killed run, was found."""
    path = Path(file)
    refuse_pipe(path, "run")
    left = [] if path.exists() else leftovers(path)
    is_store = path.suffix.lower() == ".zarr" and path.is_dir()
    if not left and not is_store:
        try:
            open(path, "rb").close()
        except OSError as error:
            raise unreadable(file, error) from None

    from dropper_jax.run.simulate import Solution

    register_effects(args)
    if left:
        recover_leftovers(path)
    return Solution.load(file)


def recover_leftovers(file: Path) -> None:
    """Recover and report the files of a killed run next to a file."""
    from dropper_jax.run.recovery import recover

    print_warnings(recover(file))


def assignments(texts: list[str]) -> Table:
    """Values by path of several `KEY=VALUE`."""
    return dict(map(_assignment, texts))


def _assignment(text: str) -> tuple[str, Plain]:
    """Path and value of `KEY=VALUE`; the value is read as TOML, or as plain text if it is not valid TOML."""
    path, equals, value = text.partition("=")
    if not equals or not path.strip():
        raise SceneError(f"--set: {text!r} is not KEY=VALUE; allowed: a path, '=' and a value, such as run.dt=0.01")
    try:
        return path.strip(), parse_toml_text(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path.strip(), value.strip()


#: Signals of `quantities.motion_signals` and statistics of `quantities.statistics`, which import JAX.
SIGNALS = (
    "tension",
    "anchor",
    "angle",
    "line",
    "curvature",
    "offset",
    "excursion",
    "depth",
    "x",
    "y",
    "z",
    "period",
    "energy",
)
STATISTICS = ("max", "min", "mean", "final", "start", "std", "fatigue", "peak", "sustained", "mpm")
QUANTITY_HELP = (
    "SIGNAL[.WHERE].STATISTIC, such as tension.3.max, tension.west-leg.fairlead.max, anchor.west.horizontal.max or "
    f"offset.buoy.max; signals: {', '.join(SIGNALS)}; statistics: {', '.join(STATISTICS)}"
)
#: Options for values of `[run]`, by their key.
RUN_VALUES: dict[str, Table] = {
    "integrator": {"metavar": "NAME", "help": f"time integration scheme: {', '.join(SCHEMES)}"},
    "solver": {"metavar": "NAME", "help": "linear solver: auto, dense, banded, condensed or network"},
    "dt": {
        "type": step_length,
        "metavar": "S",
        "help": "length of equal steps [s]; auto: the step of `dropper check`, in `run` an accuracy of 0.01",
    },
    "duration": {"type": number, "help": "simulated time [s]"},
    "dtype": {"metavar": "NAME", "help": "float64 or float32"},
    "accuracy": {
        "type": number,
        "help": "choose the steps by their error: required relative accuracy of positions and tensions, such as 0.01",
    },
    "save_interval": {"type": number, "metavar": "S", "help": "time between saved states [s]"},
    "gamma": {"type": number, "help": "weight of the new time in the theta schemes, 0 to 1"},
    "rho_infinity": {
        "type": number,
        "help": "fraction of the highest-frequency amplitude that a step of generalized_alpha keeps, 0 to 1",
    },
}
