"""`dropper frequency SCENE`: tensions and motions in irregular waves, in the frequency domain."""

from __future__ import annotations

import csv
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.cli.given import number, positive, positive_integer, read_numbers
from dropper_jax.cli.options import add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import Failure, done_object, print_warnings, record_table, table

if TYPE_CHECKING:
    from dropper_jax.frequency.response import FrequencyResponse
    from dropper_jax.load.scene import Scene

help = "tensions and motions in irregular waves in the frequency domain, with linearised drag, for many sea states"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "frequency edulis-longline --sea-states 0.5:4,1:6 --runs 1",
        "frequency edulis-longline --sea-states 0.5:5 --direction 90 --plot spectra.png",
    )
    states = parser.add_mutually_exclusive_group()
    states.add_argument(
        "--sea-states", metavar="HS:TP,...", help="heights [m] and peak periods [s] (default: the waves of the scene)"
    )
    states.add_argument("--table", metavar="FILE.csv", help="the same from columns `hs` and `tp`")
    parser.add_argument("--direction", type=number, metavar="DEG", help="of these waves, from x towards y")
    parser.add_argument("--frequencies", type=positive_integer, default=40, help="frequencies of these states (40)")
    parser.add_argument(
        "--duration", type=positive("s"), default=10800.0, metavar="S", help="of the most probable maximum [s] (10800)"
    )
    parser.add_argument(
        "--runs",
        type=positive_integer,
        metavar="N",
        help="run N of the states in time, from the most severe to the mildest, and report the differences",
    )
    add_plot(parser, "the spectra of tension of the state with the maximum tension")
    add_out(parser)


def run(args: Namespace) -> int:
    states = _sea_states(args)
    if args.runs and states is None:
        raise SceneError("--runs: needs sea states. Use --sea-states or --table")
    scene = read_scene(args)

    from dropper_jax.frequency.response import frequency_response

    how: Table = {"direction": None, "frequencies": args.frequencies}
    if args.direction is not None:
        how["direction"] = np.radians(args.direction)
    found = frequency_response(scene, states, duration=args.duration, **how)
    if args.plot:
        _draw(scene.name, found, picture(args.plot, "frequency"))
    print_warnings(found.warnings)
    plain = done_object(scene=scene.name, duration_s=found.duration, basis_error=found.basis_error)
    plain |= {"warnings": found.warnings, "states": _rows(found)}
    text = _text(found)
    if args.runs:
        runs = _runs(scene, found, args.runs, how)
        plain["runs"] = runs
        text = f"{text}\n\n{record_table(map(_with_range, runs), RUNS)}"
    return deliver(args, plain, text, _failure(found))


#: Messages of the states that fail, the worst first.
FAILURES = {
    "not_converged": "the linearised drag still changes",
    "not_linear": "lines go slack, so that tensions may be tens of per cent off; run these states in time",
}


def _failure(found: FrequencyResponse) -> Failure | None:
    """The worst failure of any sea state."""
    for status, message in FAILURES.items():
        if status in found.status:
            return status, f"{message} (sea states: {found.status.count(status)})"
    return None


def _sea_states(args: Namespace) -> np.ndarray | None:
    """Heights and periods (states, 2) of the options; None for the waves of the scene."""
    if args.sea_states is None and args.table is None:
        return None
    if args.sea_states is None:
        option = "--table"
        pairs = _table_rows(args.table)
    else:
        option = "--sea-states"
        reason = "is not HS:TP; needed: HS:TP,..., for example 1:6,2:8"
        pairs = [read_numbers(part, option, reason, ":", 2) for part in args.sea_states.split(",")]
    found = np.array(pairs)
    if not np.all(np.isfinite(found) & (found > 0.0)):
        raise SceneError(f"{option}: a height or period is missing or not positive; allowed: above 0 m and 0 s")
    return found


def _table_rows(file: str) -> list[tuple[float, float]]:
    """Heights and periods of a table."""
    try:
        with Path(file).open(newline="", encoding="utf-8-sig") as lines:
            rows = [(float(row["hs"]), float(row["tp"])) for row in csv.DictReader(lines)]
    except OSError as error:
        raise SceneError(f"--table: {file}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError):
        raise SceneError("--table: needs columns `hs` and `tp` of numbers") from None
    if not rows:
        raise SceneError(f"--table: {file!r} has no rows; needed: columns `hs` [m] and `tp` [s]")
    return rows


def _runs(scene: Scene, found: FrequencyResponse, count: int, how: Table) -> list[Table]:
    """Runs in time of states at even distances in the order of the maximum tension, and the differences from them.

    Args:
        how: direction [rad] and number of frequencies of the waves.
    """
    from dropper_jax.frequency.response import run_in_time

    order = np.argsort(-np.max(found.maximum_tension, axis=1))
    rows = []
    for i in order[np.unique(np.linspace(0, len(order) - 1, count).round().astype(int))]:
        hs, tp = found.sea_states[i]
        mean, deviation = run_in_time(scene, (hs, tp), **how)
        own = {"hs_m": hs, "tp_s": tp, "status": found.status[i], "mean_tension_n": mean}
        difference = found.tension_deviation[i] / deviation - 1.0
        rows.append(own | {"tension_deviation_n": deviation, "deviation_difference": difference})
    return rows


#: Maximum number of ends whose spectra are drawn.
MOST_SPECTRA = 6
#: Columns of the runs in time: formats of the values by heading.
RUNS = {
    "hs [m]": "{hs_m:g}",
    "tp [s]": "{tp_s:g}",
    "status": "{status}",
    "deviations against the run": "{low:+.1f} to {high:+.1f} %",
}


def _with_range(run: Table) -> Table:
    """The run with the range of the differences of all ends [%]."""
    differences = 100.0 * run["deviation_difference"]
    return {**run, "low": np.min(differences), "high": np.max(differences)}


def _rows(found: FrequencyResponse) -> list[Table]:
    """A row per sea state; with spectra if there is one state."""
    rows = []
    for i, (hs, tp) in enumerate(found.sea_states):
        ends = []
        for j, (line, point) in enumerate(found.ends):
            ends.append(
                {
                    "line": line,
                    "point": point,
                    "static_tension_n": found.static_tension[j],
                    "mean_tension_n": found.mean_tension[i, j],
                    "tension_deviation_n": found.tension_deviation[i, j],
                    "tension_period_s": found.tension_period[i, j],
                    "maximum_tension_n": found.maximum_tension[i, j],
                }
            )
        rows.append(
            {
                "hs_m": hs,
                "tp_s": tp,
                "status": found.status[i],
                "ends": ends,
                "significant_motion_m": dict(zip(found.points, 4.0 * found.motion_deviation[i], strict=True)),
                "slack_lines": [name for name, low in zip(found.lines, found.slack[i], strict=True) if low],
            }
        )
    if len(rows) == 1:
        omega, tension, motion = found.spectra()
        rows[0] |= {"omega_rad_per_s": omega, "tension_spectrum": tension, "motion_spectrum": motion}
    return rows


def _text(found: FrequencyResponse) -> str:
    """The ends of one state, or the end with the maximum tension of each state."""
    heads = ("hs [m]", "tp [s]", "line", "point", "static [N]", "mean [N]", "deviation [N]", "period [s]")
    lines = [(*heads, "most probable maximum [N]", "lines that go slack")]
    numbers = (found.mean_tension, found.tension_deviation, found.tension_period, found.maximum_tension)
    for i, (hs, tp) in enumerate(found.sea_states):
        shown: Sequence[int] = range(len(found.ends))
        if len(found.status) > 1:
            shown = [int(np.argmax(found.maximum_tension[i]))]
        for j in shown:
            values = (found.static_tension[j], *(x[i, j] for x in numbers))
            slack = str(int(np.sum(found.slack[i])))
            lines.append((f"{hs:g}", f"{tp:g}", *found.ends[j], *cells(np.round(values, 4), ".5g"), slack))
    note = f"maximum in {found.duration:g} s of Rayleigh-distributed peaks; linear where no line goes slack"
    return f"{table(lines)}\n{note}"


def _draw(name: str, found: FrequencyResponse, path: Path) -> None:
    """Spectra of the tensions at the ends with the largest deviations, in the sea state with the maximum tension."""
    from dropper_jax.plots import figures, style
    from dropper_jax.plots.time_panels import Curve, Panel, draw_panel

    state = int(np.argmax(np.max(found.maximum_tension, axis=1)))
    omega, tension, _ = found.spectra(state)
    with style.plot_style():
        figure = figures.new_figure(7.0, 4.4)
        axes = figure.subplots()
        ends = np.argsort(-found.tension_deviation[state])[:MOST_SPECTRA]
        curves = [Curve(" at ".join(found.ends[i]), omega, tension[:, i] / 1e6) for i in ends]
        draw_panel(axes, Panel("", curves))
        axes.set(xlabel="frequency [rad/s]", ylabel="spectrum of the tension [kN$^2$ s/rad]", ylim=(0.0, None))
        figure.legend(loc="outside right upper")
        hs, tp = found.sea_states[state]
        what = "tension"
        if len(ends) < len(found.ends):
            what = f"tension at {len(ends)} of {len(found.ends)} ends (the largest)"
        figures.title(figure, f"{name}: {what} in waves of {hs:.3g} m and {tp:.3g} s")
        figures.save(figure, path)
