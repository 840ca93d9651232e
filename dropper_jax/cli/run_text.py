"""A run as text: steps, errors, tensions of links and forces on end points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.base.table_cells import fill, record_cells
from dropper_jax.cli.outputs import weights_table
from dropper_jax.cli.printing import listing, table

if TYPE_CHECKING:
    from dropper_jax.run.simulate import Solution

#: Maximum number of lines of a system whose tensions are printed.
MAX_LINES = 12
#: Cells of a row of a table.
Row = Sequence[str]


def text(solution: Solution) -> str:
    """The result as text."""
    from dropper_jax.run.observation import break_in_words
    from dropper_jax.scene import link_mass_words

    pairs = [
        ("scene", solution.scene.name),
        ("integrator", "{integrator}, solver {solver}, {dtype}".format(**solution.settings)),
        ("time", _steps(solution)),
        ("mass of links", link_mass_words(solution.scene.link_mass_nodes)),
        ("steps", f"{solution.failed_steps} failed, {solution.retried_steps} retried"),
        *_step_facts(solution),
        *((name, form.format(solution)) for name, form in FACTS.items()),
        *(("broken", break_in_words(row)) for row in solution.broken),
        ("wall time", f"{solution.compile_s:.2f} s compilation, {solution.run_s:.3f} s run"),
    ]
    return "\n".join([listing(pairs), "", *_tensions(solution), *_errors(solution), "", result_line(solution)])


#: Facts of a run: formats of its attributes by name.
FACTS = {
    "residual": "{0.max_residual:.1e} maximum, scaled; closure {0.max_closure_error:.1e} m",
    "energy": "balance error {0.energy_drift:.1e} J (reference {0.energy_scale:.3g} J)",
    "speed": "{0.max_speed:.3g} m/s maximum",
}


def _step_facts(solution: Solution) -> list[tuple[str, str]]:
    """Resolution of the steps, if it is known."""
    from math import degrees

    from dropper_jax.run.stated_errors import errors_in_words
    from dropper_jax.run.step_facts import step_facts

    facts = step_facts(solution)
    found = []
    if "stated_errors" in solution.settings:
        found.append(("errors", errors_in_words(solution.settings["stated_errors"])))
    # the stated errors are the verdict
    elif facts["steps_per_axial_period"] is not None:
        text = (
            "{steps_per_axial_period:.2g} steps per period of the stiffest link, {axial_period_s:.2g} s; a step of "
            "{axial_step_s:.2g} s resolves it"
        )
        found.append(("axial motion", text.format(**facts)))
    turn = degrees(facts["largest_turn_rad"] or 0.0)
    if turn > 1.0:
        found.append(("turns", f"links rotate by up to {turn:.2g} degrees in a step"))
    if facts["slack_to_taut_steps"]:
        found.append(("snaps", "links change from slack to taut in {slack_to_taut_steps} steps".format(**facts)))
    if facts["compression_to_tension_steps"]:
        text = "rigid links change from compression to tension in {compression_to_tension_steps} steps"
        found.append(("compression", text.format(**facts)))
    return found


def _errors(solution: Solution) -> list[str]:
    """Loads with their errors, the most loaded of many lines."""
    found = solution.settings.get("load_errors")
    if found is None:
        return []
    loads = {row["line"]: row for row in found["loads"]}
    rows: dict[str, list[Row]] = {line: [record_cells(row, LOADS)] for line, row in loads.items()}
    shown = most_loaded(loads, lambda row: row["maximum"]["value"])
    return ["", table([list(LOADS), *with_gaps(rows, shown)]), *_about_errors(found)]


#: Columns of the loads with their errors: formats of the values by heading.
LOADS = {
    "line, loads [N]": "{line}",
    "at [m]": "{at_m:.4g}",
    "mean": "{mean[value]:.4g} +- {mean[error]:.2g}",
    "deviation": "{deviation[value]:.4g} +- {deviation[error]:.2g}",
    "maxima in waves": "{window_maximum[value]:.4g} +- {window_maximum[error]:.2g}",
    "maximum": "{maximum[value]:.4g} +- {maximum[error]:.2g}",
    "snaps": "{snaps[value]:.0f} +- {snaps[error]:.0f}",
}


def _about_errors(found: Table) -> list[str]:
    """Sources of the errors of the largest load, and other influences on it."""
    worst = max(column(found["loads"], "maximum"), key=lambda load: load["value"])
    of_links = fill("{links:.2g} N by the links|links not known", worst)
    lines = [
        f"+-: limit of the errors of step and links together; of the maximum load {worst['step']:.2g} N by the step, "
        f"{of_links}"
    ]
    if worst["chance"] is not None:
        lines.append(f"scatter: another storm of this length changes the maximum load by about {worst['chance']:.2g} N")
    for key, what in (("twice_damping", "internal damping"), ("twice_bed", "stiffness of the seabed")):
        if key in worst:
            lines.append(f"twice the {what}: the maximum load changes by {worst[key]:.2g} N")
    if found["chaotic"]:
        lines.append(f"the motion is chaotic from {found['horizon_s']:.3g} s on: other steps give other storms")
    return [*lines, *(f"left out: {name}: {why}" for name, why in found["left_out"].items())]


def _tensions(solution: Solution) -> list[str]:
    """Tensions of the first, the last and all links; of a system of lines by line, the most loaded of many."""
    whole = solution.tension_summary()
    parts = {"first link": whole["first"], "last link": whole["last"]}
    shown = None
    if solution.scene.branched:
        parts = solution.line_tensions()
        shown = most_loaded(parts, lambda values: values["max"])
    heads = [head.strip() for head in EXTENT]
    rows: list[Row] = [("tension of links [N]", *heads)]
    rows += with_gaps({name: [(name, *_extent_cells(values))] for name, values in parts.items()}, shown)
    # a mean over lines that differ is the load of none
    rows.append(("all links", *_extent_cells(whole["all"], mean=shown is None)))
    ends: list[Row] = [("force on end points [N]", *heads, "angle up [deg]", "min", "max")]
    ends += with_gaps(_end_rows(solution), shown)
    notes = []
    if solution.saved_rows:
        extremes = "min and max of tensions and forces are those of all steps, angles of saved ones"
        notes.append(f"{solution.saved_rows}; {extremes}")
    if shown is not None and len(shown) < len(parts):
        notes.append("not shown: lines with lower maxima; use --json to see all")
    return [table(rows), "", table(ends), *notes, *weights_table(solution.scene)]


def _end_rows(solution: Solution) -> dict[str, list[Row]]:
    """Rows of the forces and angles at both ends of each line."""
    angles = solution.end_angles()
    found: dict[str, list[Row]] = {}
    for name, both in solution.end_forces().items():
        found[name] = []
        for end, values in both.items():
            steep = (f"{angles[name][end][key] + 0.0:.2f}" for key in ("mean", "min", "max"))
            found[name].append((f"{name}, {end}", *_extent_cells(values), *steep))
    return found


def _extent_cells(values: Mapping[str, float], mean: bool = True) -> list[str]:
    """Minimum and its time, mean, maximum and its time, and the final value; `-` for mean and final without `mean`."""
    shown: Table = {**values, "mean": None, "final": None}
    for key in ("min", "max", "mean", "final"):
        if mean or key in ("min", "max"):
            shown[key] = round(values[key], 4) + 0.0  # adding zero turns -0 into 0
    return record_cells(shown, EXTENT)


#: Columns of a load over a run: formats of the values by heading.
EXTENT = {
    "min": "{min:.4f}",
    "at [s]": "{min_s:.6g}",
    "mean": "{mean:.4f}",
    "max": "{max:.4f}",
    "at [s] ": "{max_s:.6g}",
    "final": "{final:.4f}",
}


def most_loaded(parts: Mapping[str, Table], size: Callable[[Table], float]) -> set[str]:
    """Names of the `MAX_LINES` largest parts."""
    return set(sorted(parts, key=lambda name: -size(parts[name]))[:MAX_LINES])


def with_gaps(rows: Mapping[str, list[Row]], shown: set[str] | None) -> list[Row]:
    """Rows of the shown lines (None: of all) in the order of the scene, with a count where lines are left out."""
    found: list[Row] = []
    hidden = 0
    width = max((len(row) for own in rows.values() for row in own), default=0)
    for name, own in rows.items():
        if shown is None or name in shown:
            found += [*_gap(hidden, width), *own]
            hidden = 0
        else:
            hidden += 1
    return [*found, *_gap(hidden, width)]


def _gap(hidden: int, width: int) -> list[Row]:
    """A row of this number of cells with the number of lines left out, if there are any."""
    if hidden == 0:
        return []
    lines = "line" if hidden == 1 else "lines"
    return [(f"({hidden} {lines} not shown)", *[""] * (width - 1))]


def _steps(solution: Solution) -> str:
    used = solution.settings
    end = f"{solution.t[-1]:g} s"
    if "refused_steps" not in used:
        return "{steps} steps of {dt:g} s to {end}".format(**used, end=end)
    text = "{steps} steps with an accuracy of {accuracy:g} to {end}, {refused_steps} more rejected"
    if used["shortest_steps"]:
        text += ", {shortest_steps} of the shortest length with a larger error"
    return f"{text}; saved every {{dt:g}} s".format(**used, end=end)


def result_line(solution: Solution) -> str:
    """The outcome of the run in one line."""
    if solution.failure:
        return f"failed: {solution.failure}"
    text = "simulated in {0.run_s:.3g} s, {0.us_per_step:.3g} us per step, {0.realtime_factor:.3g} times real time"
    return f"ok: {solution.t[-1] - solution.t[0]:g} s {text.format(solution)}"
