"""`dropper equilibrium SCENE`: static equilibrium."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.cli.given import positive_integer
from dropper_jax.cli.options import add_flag, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, is_one_picture, picture, weights_table
from dropper_jax.cli.printing import done_object, failure_of, print_warnings, table
from dropper_jax.cli.tide import CYCLE_TIMES, run_tide

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.scene.slices import LineSlice
    from dropper_jax.statics.equilibrium import Equilibrium

help = "find the static equilibrium of a scene, under its release force if it has one"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "equilibrium dropper-release-a", "equilibrium edulis-tide --tide --times 7 --plot tide")
    add_flag(parser, "--tide", "equilibria through a cycle of current and level")
    parser.add_argument(
        "--times", type=positive_integer, help=f"equilibria in the cycle, both ends included ({CYCLE_TIMES})"
    )
    add_plot(parser, "the equilibrium, or curves through the tide,")
    add_out(parser)


def run(args: Namespace) -> int:
    if args.times is not None and not args.tide:
        raise SceneError("--times: requires --tide")
    scene = read_scene(args, notes=args.tide)
    if args.tide:
        return run_tide(scene, args)

    from dropper_jax.analysis.angles import link_angles
    from dropper_jax.modelling.build import equilibrium
    from dropper_jax.plausibility.plausibility import scene_warnings
    from dropper_jax.plausibility.pose_remarks import check_stretch, pose_remarks
    from dropper_jax.quantities.bending import crushed_links, curvature
    from dropper_jax.scene.slices import line_slices

    found = equilibrium(scene)
    lines = line_slices(scene)
    angles = np.concatenate([np.stack(link_angles(found.positions[line.nodes]), axis=-1) for line in lines])
    bent = curvature(scene, found.positions[None])[0]
    failed = found.status != "ok"
    remarks = scene_warnings(scene, at_rest=not failed)
    if not failed:
        check_stretch(scene, found.positions)
        remarks = (*remarks, *pose_remarks(scene, found.positions, found.tension))
        remarks = (*remarks, *crushed_links(scene, found.positions[None]))
    print_warnings(remarks)
    if args.plot and not failed:
        from dropper_jax.plots.tension_along import along_lines
        from dropper_jax.study.rest_pictures import pose

        pose(scene, found, picture(args.plot, "pose"))
        if not is_one_picture(args.plot):
            along_lines(scene, found.positions, found.tension, picture(args.plot, "along"))
    values = _object(scene, found, angles, bent)
    parts = _line_tables(lines, found, angles, bent)
    if not failed:
        if "held_load_n" in values:
            parts.append(_loads(values["held_load_n"]))
        parts += [_end_forces(values), *weights_table(scene), f"ok: scaled residual {found.residual:.1e}"]
    return deliver(args, {**values, "warnings": remarks}, "\n".join(parts), failure_of(found))


def _object(scene: Scene, found: Equilibrium, angles: np.ndarray, bent: np.ndarray) -> Table:
    """The equilibrium as the JSON object, with the angles (links, 2) [rad] and the curvature (nodes,) [1/m]."""
    from dropper_jax.plausibility.line_weights import line_weights
    from dropper_jax.quantities.end_forces import end_angles, end_forces, fixed_point_loads
    from dropper_jax.scene.slices import line_offsets, whole_lines

    result = done_object(
        scene=scene.name,
        residual=float(found.residual),
        angles_rad=angles,
        positions_m=found.positions,
        tension_n=found.tension,
        curvature_per_m=bent,
    )
    if found.status == "ok":
        pose = found.positions[None], found.tension[None]
        result["end_forces_n"] = _by_end(end_forces(scene, *pose))
        result["end_angles_deg"] = _by_end(end_angles(pose[0], whole_lines(scene)))
        result["line_weights"] = line_weights(scene)
    if scene.branched:
        loads = fixed_point_loads(scene, found.positions, found.tension)
        result |= {"lines": line_offsets(scene), "held_load_n": loads}
    return result


def _by_end(values: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Values (1, 2) of both ends of each line by the names of the ends."""
    found = {}
    for name, ends in values.items():
        first, last = ends[0].tolist()
        found[name] = {"first": first, "last": last}
    return found


def _line_tables(lines: Sequence[LineSlice], found: Equilibrium, angles: np.ndarray, bent: np.ndarray) -> list[str]:
    """A table of nodes and links for each line, below its name if there are several."""
    parts = []
    nodes = np.column_stack([found.positions, bent])
    links = np.column_stack([angles, found.tension])
    for line in lines:
        if len(lines) > 1:
            parts.append(f"line {line.name}")
        parts.append(_line_table(nodes[line.nodes], links[line.links]))
    note = "angles and tension are those of the link that ends at the node; polar is 0 at the horizontal, down > 0"
    return [*parts, note]


def _end_forces(found: Table) -> str:
    """Forces on the end points of lines, including the weight of the part of the end link at the point, and
    the angles of the end links above the horizontal."""
    rows = [("line", "force on first point [N]", "angle up [deg]", "force on last point [N]", "angle up [deg]")]
    for name, forces in found["end_forces_n"].items():
        row = [name]
        for end, angle in found["end_angles_deg"][name].items():
            row += [f"{forces[end]:.5g}", f"{angle + 0.0:.2f}"]
        rows.append(row)
    return table(rows)


def _loads(found: dict[str, np.ndarray]) -> str:
    """Forces of the lines on the fixed points."""
    rows = [("fixed point", "horizontal [N]", "vertical, upwards [N]", "total [N]", "uplift angle [deg]")]
    for name, (x, y, up) in found.items():
        across = np.hypot(x, y)
        size = np.hypot(across, up)
        angle = "-"  # a zero load has no direction
        if size > 0.0:
            angle = f"{np.degrees(np.arctan2(up, across)):.2f}"
        rows.append((name, *cells((across, up, size), ".5g"), angle))
    return table(rows)


def _line_table(nodes: np.ndarray, links: np.ndarray) -> str:
    """Positions and curvature of nodes (n + 1, 4), and angles and tension of the links (n, 3) that end at them."""
    heads = ("node", "x [m]", "y [m]", "z [m]", "curvature [1/m]", "polar [rad]", "azimuth [rad]", "tension [N]")
    of_links = [("", "", ""), *(cells(link, ".5f") for link in links)]
    rows: list[tuple[str, ...]] = [heads]
    for i, (node, link) in enumerate(zip(nodes, of_links, strict=True)):
        rows.append((str(i), *cells(node, ".5f"), *link))
    return table(rows)
