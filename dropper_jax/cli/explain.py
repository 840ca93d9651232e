"""`dropper explain SCENE`: the questions that users ask most about a mooring, answered by numbers."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import done_object, failure_of, print_warnings, record_table, table

if TYPE_CHECKING:
    from dropper_jax.explain.answers import Explained

help = "answers on a mooring at rest: lengths, tensions, stiffnesses, damping, wear, each next to a closed form"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "explain paper-case-1", "explain platform-longline --json")
    add_out(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args, notes=False)

    from dropper_jax.explain.answers import explain
    from dropper_jax.explain.line_facts import refuse_rigid
    from dropper_jax.modelling.build import equilibrium
    from dropper_jax.plausibility.plausibility import scene_warnings
    from dropper_jax.plausibility.pose_remarks import pose_remarks

    refuse_rigid(scene)
    pose = equilibrium(scene)
    if pose.status != "ok":
        return deliver(args, {"scene": scene.name}, "", failure_of(pose))
    found = explain(scene, pose)
    remarks = (*scene_warnings(scene, at_rest=True), *pose_remarks(scene, pose.positions, pose.tension))
    remarks = tuple(text for text in remarks if text not in found.ignored)
    print_warnings(remarks)
    values = asdict(found)
    for row, line in zip(values["lines"], found.lines, strict=True):
        row["verdict"] = line.verdict
    return deliver(args, done_object(scene=scene.name, **values, warnings=remarks), _text(found, values["lines"]))


def _text(found: Explained, lines: list[Table]) -> str:
    """Questions and answers; `lines` with their verdicts."""
    ignored = found.ignored or ("nothing",)
    parts = [
        f"Is each line long enough?\n{record_table(lines, LENGTHS)}",
        f"What tension has each line along it?\n{record_table(lines, TENSIONS)}\n{OF_TENSIONS}",
        f"Which stiffness is meant?\n{record_table(lines, STIFFNESSES)}{_stiffness(found)}",
        f"What does internal damping change?\n{record_table(lines, DAMPINGS)}\n{OF_DAMPINGS}",
        f"What does 10 % wear do?\n{record_table(map(vars, found.wear), WEARS)}\n{OF_WEARS}",
        "\n- ".join(["Which inputs were ignored?", *ignored]),
    ]
    return "\n\n".join(parts)


#: Columns of the tables: formats of the values by heading.
LENGTHS = {
    "line": "{name}",
    "length [m]": "{length_m:.5g}",
    "ends apart [m]": "{apart_m:.5g}",
    "on the bed [m]": "{on_bed_m:.5g}",
    "answer": "{verdict}",
}
TENSIONS = {
    "line": "{name}",
    "lower end [N]": "{lower_n:.6g}",
    "closed form, lower [N]": "{closed_lower_n:.6g}",
    "upper end [N]": "{upper_n:.6g}",
    "closed form, upper [N]": "{closed_upper_n:.6g}",
}
STIFFNESSES = {
    "line": "{name}",
    "axial, EA/L [N/m]": "{axial_n_per_m:.5g}",
    "of its upper end, horizontal [N/m]": "{horizontal_n_per_m:.5g}",
}
DAMPINGS = {
    "line": "{name}",
    "first axial period [s]": "{axial_period_s:.3g}",
    "damping ratio": "{damping_ratio:.3g}",
    "of the stiffest link": "{link_damping_ratio:.3g}",
}
WEARS = {
    "line": "{name}",
    "largest tension [N]": "{tension_n:.6g}",
    "worn, by derivative [N]": "{by_derivative_n:.6g}",
    "by equilibrium [N]": "{by_equilibrium_n:.6g}",
    "use": "{use:.1%}",
    "worn": "{worn_use:.1%}",
}
OF_TENSIONS = (
    "closed form: the elastic catenary between the same ends, where the line is uniform, under water and in no "
    "current;\nwhat differs is due to the number of links"
)
OF_DAMPINGS = "internal damping changes no force at rest: it damps axial waves, by these shares of the critical value"
OF_WEARS = "a tenth of the diameter gone: area, mass, EA and breaking load are 0.81 of those now"


def _stiffness(found: Explained) -> str:
    """The stiffness of the whole mooring."""
    if found.stiffness is None:
        return ""
    rows = [("", "x", "y", "z"), ("exact", *cells(np.diag(found.stiffness)[:3], ".5g"))]
    if found.closed_stiffness is not None:
        rows.append(("closed form", *cells(found.closed_stiffness, ".5g"), "-"))
    more = f"6x6: dropper stiffness SCENE --of {','.join(found.held)}"
    return f"\nof the whole mooring as {', '.join(found.held)} move together [N/m]:\n{table(rows)}\n{more}"
