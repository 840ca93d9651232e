"""`dropper equilibrium SCENE`: static equilibrium."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.cli.options import (
    add_examples,
    add_scene,
    done_object,
    positive_integer,
    print_warnings,
    read_scene,
    table,
)
from dropper_jax.cli.outputs import add_out, add_plot, deliver, out_file, picture, plot_folder, weights_table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.scene.data import LineSlice
    from dropper_jax.statics.search import Equilibrium

help = "find the static equilibrium of a scene, under its release force if it has one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_examples(
        parser,
        "equilibrium dropper-release-a",
        "equilibrium edulis-tide --tide --times 7 --plot tide",
    )
    add_scene(parser)
    parser.add_argument("--tide", action="store_true", help="equilibria through a cycle of current and level")
    parser.add_argument(
        "--times", type=positive_integer, default=13, help="number of equilibria in the cycle, both ends included (13)"
    )
    add_plot(parser, "the equilibrium, or curves through the tide,")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    plot, out = plot_folder(args.plot), out_file(args.out)
    scene = read_scene(args)
    if args.tide:
        return _tide(scene, args, plot, out)

    from dropper_jax.analysis.angles import link_angles
    from dropper_jax.load.checks_system import body_warnings
    from dropper_jax.run.bends import curvature
    from dropper_jax.run.build import equilibrium
    from dropper_jax.run.growth import floating_warnings
    from dropper_jax.run.resolution import check_stretch, pose_remarks
    from dropper_jax.scene.data import line_slices

    found = equilibrium(scene)
    lines = line_slices(scene)
    angles = np.concatenate([np.stack(link_angles(found.positions[line.nodes]), axis=-1) for line in lines])
    bent = curvature(scene, np.asarray(found.positions)[None])[0]
    failed = found.status != "ok"
    if not failed:
        check_stretch(scene, found.positions)
    remarks = () if failed else pose_remarks(scene, found.positions, found.tension)
    remarks = (*remarks, *floating_warnings(scene), *body_warnings(scene))
    print_warnings(remarks)
    if plot and not failed:
        from dropper_jax.plots.tension import along_lines
        from dropper_jax.study.pictures import pose

        pose(scene, found, picture(plot, "pose"))
        if plot.is_dir():
            along_lines(scene, np.asarray(found.positions), np.asarray(found.tension), picture(plot, "along"))
    text = _text(lines, found, angles, bent)
    if scene.branched and not failed:
        text += "\n" + _loads(scene, found)
    if not failed:
        last = f"ok: scaled residual {found.residual:.1e}"
        text += "\n" + "\n".join([_end_forces(scene, found), *weights_table(scene), last])
    failure = (found.status, f"{found.status}: {found.message}") if failed else None
    return deliver(args.json, {**_object(scene, found, angles, bent), "warnings": remarks}, text, out, failure)


def _tide(scene: Scene, args: argparse.Namespace, plot: Path | None, out: Path | None) -> int:
    """The cycle as a table, or one object."""
    from dropper_jax.study.sea_facts import tidal_cycle

    found = tidal_cycle(scene, args.times)
    failed = next((s for s in (found["slack_status"], *(r["status"] for r in found["rows"])) if s != "ok"), None)
    if plot and not failed:
        from dropper_jax.study.pictures import tide

        tide(scene.name, found["rows"], picture(plot, "tide"))
    failure = (failed, f"{failed}: no equilibrium found for one instant of the cycle") if failed else None
    return deliver(args.json, done_object(scene=scene.name, **found), _tide_text(found), out, failure)


def _tide_text(found: dict[str, Any]) -> str:
    names = list(found["rows"][0]["held_load_n"])
    anchors = list(found["rows"][0]["anchor_utilisation"])
    heads = (*(f"{name} [N]" for name in names), *(f"{name} used [%]" for name in anchors))
    rows = [("time [h]", "level [m]", "current [m/s]", "moved [m]", *heads)]
    for row in found["rows"]:
        loads = (np.linalg.norm(load) for load in row["held_load_n"].values())
        used = (100.0 * share for share in row["anchor_utilisation"].values())
        values = (
            row["t_s"] / 3600.0,
            row["level_m"],
            row["speed_m_per_s"],
            row["displacement_m"],
            *loads,
            *used,
        )
        rows.append(tuple(f"{value:.4g}" for value in values))
    note = "moved: maximum horizontal displacement of a node from the equilibrium without current at the mean level"
    return f"{table(rows)}\n{note}"


def _object(scene: Scene, found: Equilibrium, angles: np.ndarray, bent: np.ndarray) -> dict[str, Any]:
    from dropper_jax.run.growth import line_weights
    from dropper_jax.scene.data import held_loads, line_offsets

    result = done_object(
        scene=scene.name,
        residual=float(found.residual),
        angles_rad=angles,
        positions_m=found.positions,
        tension_n=found.tension,
        curvature_per_m=bent,
    )
    if found.status == "ok":
        result |= {**_ends(scene, found), "line_weights": line_weights(scene)}
    if scene.branched:
        result |= {"lines": line_offsets(scene), "held_load_n": held_loads(scene, found.positions, found.tension)}
    return result


def _text(lines: Sequence[LineSlice], found: Equilibrium, angles: np.ndarray, bent: np.ndarray) -> str:
    parts = []
    for line in lines:
        if len(lines) > 1:
            parts.append(f"line {line.name}")
        nodes = found.positions[line.nodes], bent[line.nodes]
        parts.append(_line_table(*nodes, found.tension[line.links], angles[line.links]))
    note = "angles and tension are those of the link that ends at the node; polar is 0 at the horizontal, down > 0"
    return "\n".join([*parts, note])


def _ends(scene: Scene, found: Equilibrium) -> dict[str, dict[str, dict[str, float]]]:
    """Force [N] of each line on its first and last point, and the angle of its end links above the horizontal [deg]."""
    from dropper_jax.run.growth import end_angles, end_forces
    from dropper_jax.scene.data import whole_lines

    pose = np.asarray(found.positions)[None], np.asarray(found.tension)[None]
    each = {"end_forces_n": end_forces(scene, *pose), "end_angles_deg": end_angles(pose[0], whole_lines(scene))}
    return {
        key: {name: dict(zip(("first", "last"), both[0].tolist(), strict=True)) for name, both in values.items()}
        for key, values in each.items()
    }


def _end_forces(scene: Scene, found: Equilibrium) -> str:
    """Forces on the end points of lines, including the weight in water of the part of the end link at the point, and
    the angles of the end links above the horizontal."""
    forces, angles = _ends(scene, found).values()
    rows = [("line", "force on first point [N]", "angle up [deg]", "force on last point [N]", "angle up [deg]")]
    for name, both in forces.items():
        cells = ((f"{both[end]:.5g}", f"{angles[name][end] + 0.0:.2f}") for end in ("first", "last"))
        rows.append((name, *(cell for pair in cells for cell in pair)))
    return table(rows)


def _loads(scene: Scene, found: Equilibrium) -> str:
    """Forces of the lines on the fixed points."""
    from dropper_jax.scene.data import held_loads

    rows = [("fixed point", "horizontal [N]", "vertical, upwards [N]", "total [N]", "uplift angle [deg]")]
    for name, load in held_loads(scene, found.positions, found.tension).items():
        across, up, size = np.hypot(load[0], load[1]), load[2], np.linalg.norm(load)
        angle = "-" if size == 0 else f"{np.degrees(np.arctan2(up, across)):.2f}"
        rows.append((name, f"{across:.5g}", f"{up:.5g}", f"{size:.5g}", angle))
    return table(rows)


def _line_table(positions: np.ndarray, bent: np.ndarray, tension: np.ndarray, angles: np.ndarray) -> str:
    heads = ("node", "x [m]", "y [m]", "z [m]", "curvature [1/m]", "polar [rad]", "azimuth [rad]", "tension [N]")
    rows = [heads]
    for i, (x, y, z) in enumerate(positions):
        link = (*angles[i - 1], tension[i - 1]) if i else ()
        cells = [f"{value:.5f}" for value in (x, y, z, bent[i], *link)]
        rows.append((str(i), *cells, *[""] * (7 - len(cells))))
    return table(rows)
