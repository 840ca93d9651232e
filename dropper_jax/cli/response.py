"""`dropper response SCENE`: response of a pendulum to regular waves over their period."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from dropper_jax.base.errors import SceneError, first_failure
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.cli.given import read_spaced
from dropper_jax.cli.options import add_flag, add_quiet, add_scene, read_scene
from dropper_jax.cli.outputs import add_out, add_plot, deliver, picture
from dropper_jax.cli.printing import done_object, progress, record_table

help = "mean, amplitude and phase of the first link's angle in regular waves of several periods"


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(
        parser,
        "response wet-pendulum-wave --periods 2.4:3.6:4",
        "response wet-pendulum-wave --periods 2:6:9 --plot response.png",
    )
    parser.add_argument("--periods", required=True, metavar="LO:HI:N", help="periods [s], N from LO to HI")
    add_flag(parser, "--no-higher-waves", "leave out the runs with waves of 1.1 times the height")
    add_plot(parser, "the curves over the period")
    add_out(parser)
    add_quiet(parser)


def run(args: Namespace) -> int:
    periods = _periods(args.periods)
    scene = read_scene(args)

    from dropper_jax.study.response import draw_responses, responses

    rows = responses(scene, periods, not args.no_higher_waves, progress(args.quiet))
    failed = first_failure(column(rows, "status"))
    if args.plot and not failed:
        draw_responses(scene.name, rows, picture(args.plot, "response"))
    failure = (failed, f"{failed}: a run did not complete") if failed else None
    return deliver(args, done_object(scene=scene.name, rows=rows), _text(rows), failure)


def _periods(text: str) -> np.ndarray:
    low, high, count = read_spaced(text, "--periods", "is not LO:HI:N, N >= 1. Use for example 2.0:4.0:9")
    if not np.isfinite([low, high]).all() or min(low, high) <= 0.0:
        raise SceneError(f"--periods: {text!r} is out of range; allowed: periods above 0 s")
    return np.linspace(low, high, count)


COLUMNS = {
    "period [s]": "{period_s:.4g}",
    "mean [rad]": "{mean_rad:.4g}",
    "amplitude [rad]": "{amplitude_rad:.4g}",
    "phase [rad]": "{phase_rad:.4g}",
    "wet": "{wet:.4g}",
    "in waves 10 % higher": "{amplitude_10_percent_more:percent +.1f} %",
}


def _text(rows: list[Table]) -> str:
    lines = [{"amplitude_10_percent_more": None, **row} for row in rows]
    return (
        f"{record_table(lines, COLUMNS)}\nangle of the first link from the vertical in the plane of the waves; "
        "phase ahead of the elevation at its fixed point\n"
        "wet: mean wet fraction of the far end; last column: change of the amplitude"
    )
