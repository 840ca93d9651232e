"""`dropper explain SCENE`: the questions that users ask most about a mooring, answered by numbers."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

from dropper_jax.base.markdown import cell, cells
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_out, deliver
from dropper_jax.cli.printing import done_object, failure_of, print_result, print_warnings, table

if TYPE_CHECKING:
    from dropper_jax.explain.answers import Explained, LineFacts

help = "answers on a mooring at rest: lengths, tensions, stiffnesses, damping, wear, each beside a closed form"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, "explain paper-case-1", "explain platform-longline --json")
    add_out(parser)


def run(args: Namespace) -> int:
    scene = read_scene(args, notes=False)

    from dropper_jax.explain.answers import explain, refuse_rigid
    from dropper_jax.run.build import equilibrium
    from dropper_jax.run.plausibility import scene_warnings
    from dropper_jax.run.pose_remarks import pose_remarks

    refuse_rigid(scene)
    pose = equilibrium(scene)
    if pose.status != "ok":
        return print_result(args, {"scene": scene.name}, failure=failure_of(pose))
    found = explain(scene, pose)
    remarks = (*scene_warnings(scene, at_rest=True), *pose_remarks(scene, pose.positions, pose.tension))
    remarks = tuple(text for text in remarks if text not in found.ignored)
    print_warnings(remarks)
    values = asdict(found)
    for row, line in zip(values["lines"], found.lines, strict=True):
        row["verdict"] = line.verdict
    return deliver(args, done_object(scene=scene.name, **values, warnings=remarks), _text(found))


def _text(found: Explained) -> str:
    parts = [
        _lengths(found),
        _tensions(found),
        _stiffness(found),
        _damping(found),
        _wear(found),
        _ignored(found),
    ]
    return "\n\n".join(parts)


def _lengths(found: Explained) -> str:
    rows = [("line", "length [m]", "ends apart [m]", "on the bed [m]", "answer")]
    for line in found.lines:
        sizes = (line.length_m, line.apart_m, line.on_bed_m)
        rows.append((line.name, *cells(sizes, ".5g"), line.verdict))
    return f"Is each line long enough?\n{table(rows)}"


def _tensions(found: Explained) -> str:
    rows = [("line", "lower end [N]", "closed form [N]", "upper end [N]", "closed form [N]")]
    for line in found.lines:
        rows.append(
            (
                line.name,
                f"{line.lower_n:.6g}",
                cell(line.closed_lower_n, ".6g"),
                f"{line.upper_n:.6g}",
                cell(line.closed_upper_n, ".6g"),
            )
        )
    note = (
        "closed form: the elastic catenary between the same ends, where the line is uniform, under water and in no "
        "current;\nwhat differs is due to the number of links"
    )
    return f"What tension has each line along it?\n{table(rows)}\n{note}"


def _stiffness(found: Explained) -> str:
    rows = [("line", "axial, EA/L [N/m]", "of its upper end, horizontal [N/m]")]
    rows += [(line.name, f"{line.axial_n_per_m:.5g}", cell(line.horizontal_n_per_m, ".5g")) for line in found.lines]
    text = f"Which stiffness is meant?\n{table(rows)}"
    if found.stiffness is None:
        return text
    diagonal = [("", "x", "y", "z"), ("exact", *(f"{found.stiffness[i, i]:.5g}" for i in range(3)))]
    if found.closed_stiffness is not None:
        diagonal.append(("closed form", *cells(found.closed_stiffness, ".5g"), "-"))
    points = ", ".join(found.held)
    more = f"6x6: dropper stiffness SCENE --of {','.join(found.held)}"
    return f"{text}\nof the whole mooring as {points} move together [N/m]:\n{table(diagonal)}\n{more}"


def _damping(found: Explained) -> str:
    rows = [("line", "first axial period [s]", "damping ratio", "of the stiffest link")]
    rows.extend(_damping_of(line) for line in found.lines)
    note = "internal damping changes no force at rest: it damps axial waves, by these shares of the critical value"
    return f"What does internal damping change?\n{table(rows)}\n{note}"


def _damping_of(line: LineFacts) -> tuple[str, str, str, str]:
    period = f"{line.axial_period_s:.3g}"
    return line.name, period, f"{line.damping_ratio:.3g}", f"{line.link_damping_ratio:.3g}"


def _wear(found: Explained) -> str:
    rows = [("line", "largest tension [N]", "worn, by derivative [N]", "by equilibrium [N]", "use", "worn")]
    for row in found.wear:
        uses = cells((row.use, row.worn_use), ".1%")
        numbers = (f"{row.tension_n:.6g}", f"{row.by_derivative_n:.6g}", cell(row.by_equilibrium_n, ".6g"))
        rows.append((row.name, *numbers, *uses))
    note = "a tenth of the diameter gone: area, mass, EA and breaking load are 0.81 of those now"
    return f"What does 10 % wear do?\n{table(rows)}\n{note}"


def _ignored(found: Explained) -> str:
    lines = found.ignored or ("nothing",)
    return "\n".join(["Which inputs were ignored?", *(f"- {text}" for text in lines)])
