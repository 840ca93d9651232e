"""`dropper stiffness SCENE`: the mooring stiffness matrix of points and bodies about the equilibrium."""

from __future__ import annotations

import csv
import io
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.base.markdown import cells
from dropper_jax.base.records import names_of
from dropper_jax.cli.given import read_numbers, split_names
from dropper_jax.cli.options import add_flag, add_scene, read_scene
from dropper_jax.cli.outputs import add_file, deliver
from dropper_jax.cli.printing import done_object, failure_of, print_result, print_warnings, table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.model import Model, State
    from dropper_jax.statics.stiffness import Stiffness

help = "stiffness matrix of points and rigid bodies about the static equilibrium, all else in equilibrium"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "stiffness paper-case-4 --points buoy --out stiffness.csv",
        "stiffness ballasted-spar --of spar --lines-only --at 0,0,0",
    )
    of = parser.add_mutually_exclusive_group()
    of.add_argument("--points", metavar="A,B", help="points and bodies (default: all bodies, else all free points)")
    of.add_argument(
        "--of",
        metavar="BODY",
        help="the 6x6 matrix of one body, or of fixed points A,B,C that move together as a rigid body",
    )
    parser.add_argument(
        "--at",
        metavar="X,Y,Z",
        help="reference point of that matrix [m] (default: the reference of the body; 0,0,0 for points)",
    )
    add_flag(parser, "--lines-only", "of a body without its weight, buoyancy and waterline: its mooring")
    add_file(parser, "--out", (".csv", ".json"), "write the matrix (.csv) or the output of --json (.json)")


def run(args: Namespace) -> int:
    scene = read_scene(args)
    names, about = _requested_points(scene, args)

    from dropper_jax.modelling.build import build_model, equilibrium
    from dropper_jax.statics.loads import release_loads
    from dropper_jax.statics.stiffness import mooring_stiffness

    pose = equilibrium(scene)
    if pose.status != "ok":
        return print_result(args, {"scene": scene.name}, failure=failure_of(pose))
    model = build_model(scene)
    if args.of is None:
        found = mooring_stiffness(model, pose.state, names, release_loads(model, scene.start))
    else:
        found = _of_one(scene, model, pose.state, names, about, args.lines_only)
    print_warnings(found.warnings)
    values = {"points": found.names, "freedoms": found.freedoms, "stiffness": found.matrix}
    result = done_object(scene=scene.name, **values, warnings=found.warnings)
    if args.out is not None and args.out.suffix.lower() == ".csv":
        atomic_write(args.out, _csv_text(found))
        return print_result(args, result, _text(found))
    return deliver(args, result, _text(found))


def _requested_points(scene: Scene, args: Namespace) -> tuple[list[str], np.ndarray | None]:
    """Names and the reference point, checked."""
    if args.of is None:
        if args.at is not None or args.lines_only:
            raise SceneError("--at, --lines-only: need --of BODY, the body or rigid group of the matrix")
        return _names(scene, args.points), None
    names = split_names(args.of)
    is_body = len(names) == 1 and names[0] in names_of(scene.bodies)
    if args.lines_only and not is_body:
        raise SceneError(f"--lines-only: {args.of!r} is not a body, and points have no weight of their own")
    if args.at is None:
        return names, None
    reason = "is not X,Y,Z; allowed: three numbers [m] such as 0,0,-5"
    about = np.array(read_numbers(args.at, "--at", reason, count=3))
    if not np.all(np.isfinite(about)):
        raise SceneError(f"--at: {args.at!r} {reason}")
    return names, about


def _of_one(
    scene: Scene, model: Model, pose: State, names: list[str], about: np.ndarray | None, lines_only: bool
) -> Stiffness:
    """The 6x6 matrix of a body, or of fixed points that move together, about a reference (3,) [m]."""
    from dropper_jax.modelling.build import build_model, equilibrium
    from dropper_jax.modelling.fixed_points import without_body
    from dropper_jax.statics.loads import release_loads
    from dropper_jax.statics.rigid_group import moved_to, stiffness_of_group
    from dropper_jax.statics.stiffness import mooring_stiffness

    bodies = names_of(scene.bodies)
    if names[0] not in bodies or len(names) > 1:
        if about is None:
            about = np.zeros(3)
        return stiffness_of_group(model, pose, names, about)
    reference = np.asarray(model.constraints[0].pose(model, pose.r)[0])[bodies.index(names[0])]
    if lines_only:
        moored, points = without_body(scene, names[0], model, pose)
        own = equilibrium(moored)
        if own.status != "ok":
            raise SceneError(f"--lines-only: {own.message}")
        if about is None:
            about = reference
        return stiffness_of_group(build_model(moored), own.state, points, about, names[0])
    found = mooring_stiffness(model, pose, names, release_loads(model, scene.start))
    if about is None:
        return found
    return replace(found, matrix=moved_to(found.matrix, about - reference))


def _names(scene: Scene, given: str | None) -> list[str]:
    """The names of `--points`, or all bodies, or all free points."""
    if given is not None:
        return split_names(given)
    names = [body.name for body in scene.bodies if not body.pinned]
    names = names or [p.name for p in scene.points if p.is_free and p.carrier is None]
    if not names:
        fixed = ", ".join(names_of(scene.points))
        raise SceneError(f"--points: the scene has no free point; allowed: fixed points by name, such as {fixed}")
    return names


#: Maximum number of degrees of freedom of a printed matrix.
PRINTED_FREEDOMS = 12


def _text(found: Stiffness) -> str:
    if len(found.freedoms) <= PRINTED_FREEDOMS:
        rows = [("", *found.freedoms)]
        rows += [(name, *cells(line, ".5g")) for name, line in zip(found.freedoms, found.matrix, strict=True)]
        return f"{table(rows)}\nN/m; N, N m/rad for rotations: minus the force on a row per displacement of a column"
    owners = [freedom.rpartition(".")[0] for freedom in found.freedoms]
    pairs = ("xx", "yy", "zz", "xy", "xz", "yz")
    rows = [("point", *(f"{pair} [N/m]" for pair in pairs))]
    across = ["xyz".index(pair[0]) for pair in pairs]
    along = ["xyz".index(pair[1]) for pair in pairs]
    for name in found.names:
        first = owners.index(name)
        block = found.matrix[first:, first:]
        rows.append((name, *cells(block[across, along], ".5g")))
    return f"{table(rows)}\nof each point, the other {len(found.names) - 1} fixed; the full matrix: --json or --out"


def _csv_text(found: Stiffness) -> str:
    """The matrix as a table, each number with all its digits."""
    target = io.StringIO()
    rows = csv.writer(target)
    rows.writerow(["freedom", *found.freedoms])
    for name, line in zip(found.freedoms, np.asarray(found.matrix).tolist(), strict=True):
        rows.writerow([name, *line])
    return target.getvalue()
