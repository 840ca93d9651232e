"""`dropper sea SCENE`: properties of the waves and the current of a scene."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_file, add_out, add_plot, deliver, is_one_picture, picture
from dropper_jax.cli.printing import done_object, listing, print_line, print_warnings, table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene

help = "waves and current of a scene: theory, length, breaking, regime"

#: Height and period that are marked on the map, by the kind of waves.
MARKED = {"regular": ("height_m", "period_s"), "irregular": ("significant_height_m", "peak_period_s")}
#: Names in the text, with units.
WORDS = {
    "height_m": "height [m]",
    "period_s": "period [s]",
    "length_m": "length [m]",
    "celerity_m_per_s": "celerity [m/s]",
    "crest_m": "crest [m]",
    "trough_m": "trough [m]",
    "crest_speed_m_per_s": "speed of the water in the crest [m/s]",
    "mean_eulerian_m_per_s": "mean Eulerian velocity [m/s]",
    "mean_transport_m_per_s": "mean velocity of mass transport [m/s]",
    "depth_over_length": "depth over length",
    "steepness": "steepness",
    "ursell": "Ursell number H L^2/d^3",
    "second_harmonic": "second harmonic over the first",
    "fitting_theory": "theory that `auto` selects",
    "highest_m": "maximum wave height of this length [m]",
    "share_of_highest": "share of it",
    "harmonics": "harmonics",
    "significant_height_m": "significant height Hs [m]",
    "mean_period_s": "mean period Tz [s]",
    "peak_period_s": "peak period [s]",
    "hs_over_depth": "Hs over depth",
    "breaking_hs_m": "Hs at which the sea breaks [m]",
    "breaking_by": "which is a limit of",
    "share_of_breaking": "share of it",
}
#: Momentum deficit behind all lines over their drag, up to which the water would flow around the farm.
DENSE_FARM = 0.99


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "sea paper-case-1", "sea dropper-regular-wave --plot sea")
    add_plot(parser, "the map of wave theories and the map of the current behind lines")
    add_out(parser)
    formats = (".png", ".pdf", ".svg")
    add_file(parser, "--flow", formats, "map of the current behind the lines, from above", "FILE.png")
    about = "map of wave theories by depth and height, with the wave of the scene"
    add_file(parser, "--regimes", formats, about, "FILE.png")


def run(args: Namespace) -> int:
    scene = read_scene(args)
    if scene.sea is None:
        raise SceneError(f"sea: scene {scene.name!r} has no [sea]. Use a scene with water")
    if args.regimes and scene.sea.waves is None:
        raise SceneError(f"--regimes: scene {scene.name!r} has no waves. Use a scene with [sea.waves]")

    from dropper_jax.load.sea_warnings import sea_warnings
    from dropper_jax.load.surface import line_reach
    from dropper_jax.modelling.flow_coefficients import flow_dependent_effects, flow_table, with_flow_coefficients
    from dropper_jax.modelling.growth import overgrown
    from dropper_jax.modelling.wakes import has_wakes, scene_wakes, wake_facts
    from dropper_jax.sea.make import make_sea
    from dropper_jax.study.sea_facts import sea_facts

    found = sea_facts(scene)
    regimes = args.regimes
    flow = args.flow
    if args.plot:
        regimes, flow = _chosen_pictures(args, scene, has_wakes(scene))
    if flow_dependent_effects(scene):
        found["coefficients"] = flow_table(overgrown(scene))
    if flow or has_wakes(scene):
        solved = scene_wakes(with_flow_coefficients(overgrown(scene)))
        found["wakes"] = wake_facts(solved)
    if flow:
        from dropper_jax.plots.wake_map import flow_map

        flow_map(scene.name, solved, flow)
    if regimes:
        _draw(scene.name, found, scene.sea.gravity, regimes)
    warnings = sea_warnings(scene, make_sea(scene.sea, line_reach(scene)))
    print_warnings(warnings)
    return deliver(args, done_object(scene=scene.name, **found, warnings=warnings), _text(found))


def _chosen_pictures(args: Namespace, scene: Scene, wakes: bool) -> tuple[Path | None, Path | None]:
    """Files of the maps of waves and of the current by --plot, where --regimes and --flow name no others.

    One file takes the map of the waves, that of the current in calm water.
    """
    regimes = args.regimes
    flow = args.flow
    waves = scene.needed_sea.waves is not None
    if waves and regimes is None:
        regimes = picture(args.plot, "regimes")
    if wakes and flow is None and not (waves and is_one_picture(args.plot)):
        flow = picture(args.plot, "flow")
    if not waves and not wakes:
        print_line("pictures: no waves and no wakes; nothing is drawn")
    return regimes, flow


def _draw(name: str, found: Table, gravity: float, picture: Path) -> None:
    """The map of wave theories with the waves of the scene."""
    from dropper_jax.plots.wave_theories import regimes

    waves = found["waves"]
    height, period = MARKED[waves["kind"]]
    regimes([(name, waves[height], waves[period], found["depth_m"])], gravity, picture)


def _text(found: Table) -> str:
    """The facts as text."""
    pairs = [("depth [m]", f"{found['depth_m']:g}"), *_wave_pairs(found["waves"]), *_current_pairs(found["current"])]
    return "\n".join([listing(pairs), *_coefficients(found), *_wake_lines(found)])


def _wave_pairs(waves: Table | None) -> list[tuple[str, str]]:
    """Properties of the waves."""
    if waves is None:
        return [("waves", "none")]
    pairs = [("waves", "{kind}, {theory}".format(**waves))]
    for key, words in WORDS.items():
        value = waves.get(key)
        if isinstance(value, str):
            pairs.append((words, value))
        elif value is not None:
            pairs.append((words, f"{value:.5g}"))
    return pairs


def _current_pairs(current: Table | None) -> list[tuple[str, str]]:
    """Speed and direction of the current by height."""
    if current is None:
        return [("current", "none")]
    pairs = []
    for z, speed, course in zip(current["heights_m"], current["speed_m_per_s"], current["direction_rad"], strict=True):
        pairs.append((f"current at z = {z:g} m", f"{speed:.4g} m/s towards {np.degrees(course):.4g} degrees from x"))
    return pairs


def _coefficients(found: Table) -> list[str]:
    """Flow-dependent coefficients, by line."""
    if "coefficients" not in found:
        return []
    from dropper_jax.modelling.flow_coefficients import flow_cells

    low = [row["line"] for row in found["coefficients"] if not row["post_critical"]]
    note = f"Re below 1e5, where rough cylinders may not yet be post-critical: {', '.join(low)}"
    lines = ["", table(flow_cells(found["coefficients"]))]
    if low:
        lines.append(note)
    return lines


def _wake_lines(found: Table) -> list[str]:
    """Fractions of the current, by line."""
    if "wakes" not in found:
        return []
    rows = [("line", "share of the current")]
    rows += [(row["line"], "{min:.3g} to {max:.3g}".format(**row["share"])) for row in found["wakes"]["lines"]]
    balance = found["wakes"]["balance"]
    note = f"momentum deficit behind all lines over their drag: {balance:.3f}"
    if balance <= DENSE_FARM:
        note += "; the farm is too dense for wakes alone: water would flow around it"
    return ["", table(rows), note]
