"""Cases on the motion of one point: the run of this package, and MoorDyn on the same scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.study.peers import moordyn_run
from dropper_jax.study.stability.case import Case, Outcome, Watched


def watch(name: str, claim: str, limit: float, unit: str, make: Callable[[bool], Watched]) -> Case:
    """A case with a measure of the path of a point; `make(short)` gives the scene and the point."""

    def measure(short: bool) -> Outcome:
        watched = make(short)
        run = simulate(watched.scene, dt=watched.dt, duration=watched.duration)
        return outcome(run, watched)

    return Case(name, claim, limit, unit, measure)


def outcome(run: Solution, watched: Watched) -> Outcome:
    """The measured value of a run; infinite if the run did not complete."""
    if run.status != "ok":
        return Outcome(float("inf"), run.status, watched=watched)
    return Outcome(watched.measure(run.t, run.point_path(watched.point)), run.status, watched=watched)


@cache
def moordyn_there() -> bool:
    return moordyn_run.is_installed()


def peers(watched: Watched, limit: float) -> dict[str, Any]:
    """MoorDyn on a case by scheme: {status, measured, holds}, with `failed_at_s` if the run did not complete."""
    return {label: _peer(watched, limit, scheme) for label, scheme in moordyn_run.SCHEMES.items()}


def _peer(watched: Watched, limit: float, scheme: str | None) -> dict[str, Any]:
    given = (watched.scene, watched.point, watched.dt, watched.duration, scheme, watched.drive)
    run = moordyn_run.run_point(*given)
    if not run.ok:
        return {"status": "unstable", "failed_at_s": float(watched.dt * len(run.t)), "holds": False}
    measured = float(watched.measure(run.t, run.positions))
    return {"status": "ok", "measured": measured, "holds": measured <= limit}
