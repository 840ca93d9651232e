"""MoorDyn v2 on the hard cases whose claim is about the path of a point, with rk2 at the case's step and its default.

    python benchmarks/moordyn_hard_cases.py [NAME ...]

Needs the extra `moordyn`; takes about five minutes. Writes results/moordyn_hard_cases.json.
"""

from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np
from moordyn_runs import looks_at
from study import Found, Rows, collect, columns, command, table_of

from dropper_jax import Scene, build_model
from dropper_jax.stability import Case, all_cases, evaluate
from dropper_jax.stability.case import scene_of
from dropper_jax.stability.measures import OF_PATHS

#: MoorDyn's time integrators by label; None leaves scheme and step to MoorDyn.
SCHEMES = {"moordyn rk2": "rk2", "moordyn default": None}
#: What decks do not have: stream function, coefficients that follow the flow, a tide that turns, links without nodes.
NOT_IN_DECKS = ("steep-wave-float", "flow-coefficients", "turning-tide", "pendulum-in-waves")


def compare(names: list[str]) -> Iterator[Found]:
    """A row of each case that MoorDyn can be given: what is measured here and there."""
    for case in all_cases():
        if case.measure in OF_PATHS and case.name not in NOT_IN_DECKS and (not names or case.name in names):
            here = evaluate(case, compare=False)
            theirs = {label: measured(case, scheme) for label, scheme in SCHEMES.items()}
            yield {
                "name": here.name,
                "measured": here.measured,
                "unit": here.unit,
                "limit": here.limit,
                "moordyn": theirs,
            }


def measured(case: Case, scheme: str | None) -> Found:
    """MoorDyn on a case: {status, measured, holds}, with `failed_at_s` if the run did not complete."""
    scene = scene_of(case.scene)
    drive = moved_points(scene)
    speed = None if drive is None else (drive(1e-6) - drive(0.0)) / 1e-6
    end = end_of_line(scene, case.point)
    run = looks_at(scene, case.dt, case.duration, case.dt, (), [end], drive, speed=speed, tScheme=scheme)
    if run.status != "ok":
        return {"status": "unstable", "failed_at_s": case.dt * (1 + len(run.t)), "holds": False}
    t = np.append(0.0, run.t)
    value = float(OF_PATHS[case.measure](case, t, np.concatenate([run.start[None], run.position])[:, 0]))
    return {"status": "ok", "measured": value, "holds": value <= case.limit}


def end_of_line(scene: Scene, point: str) -> tuple[int, bool]:
    """Number from 1 of a line that ends at a point, at the base of its buoy if it has one; whether by its last end."""
    i, line = next((i, line) for i, line in enumerate(scene.lines, 1) if point in (line.start, line.end))
    return i, line.start != point


def moved_points(scene: Scene) -> Callable[[float], np.ndarray] | None:
    """Positions (3 m,) [m] over time of the points that `end_motion` moves."""
    moving = [effect for effect in build_model(scene).effects if effect.name == "end_motion"]
    if not moving:
        return None
    motion = scene.effects["end_motion"]
    positions = np.array([scene.point(name).position for name in (motion["point"], *motion["also"])])
    return lambda t: (positions + np.asarray(moving[0].displace(jnp.asarray(t)))).ravel()


@table_of("moordyn_hard_cases")
def moordyn_hard_cases(found: Found) -> Rows:
    return columns(
        found["cases"],
        ("case", "{name}"),
        ("here", "{measured:.0e} {unit}"),
        ("limit", "{limit:.0e}"),
        *((label, _cell, label) for label in SCHEMES),
    )


def _cell(row: Found, label: str) -> str:
    found = row["moordyn"][label]
    if found["status"] != "ok":
        return f"{found['status']} at {found['failed_at_s']:.3g} s"
    return f"{'holds' if found['holds'] else 'wrong'}, {found['measured']:.0e}"


@command({"names": [str]})
def main(args) -> None:
    collect("moordyn_hard_cases", {"cases": compare(args.names)}, by="name", schema=1)
