"""The accuracy report of a scene: reference, work-precision rows, orders, advice, damping, claims, convergence."""

from __future__ import annotations

from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.run.build import build
from dropper_jax.study.advice import advice
from dropper_jax.study.convergence import convergence
from dropper_jax.study.euler import euler_claims
from dropper_jax.study.load_convergence import load_convergence
from dropper_jax.study.numerical_damping import numerical_damping
from dropper_jax.study.peers import peer_rows
from dropper_jax.study.reference import Reference, reference, trusted_span
from dropper_jax.study.schemes import Scheme, default_schemes, runnable
from dropper_jax.study.work_precision import measure, orders

#: Steps [s] unless the user gives some: powers of two, which meet whole seconds and each other.
DTS = tuple(2.0**-k for k in range(5, 12))
#: Longest span compared [s].
LONGEST = 20.0


def accuracy(
    scene: Scene,
    schemes: list[Scheme] | None = None,
    dts: tuple[float, ...] = DTS,
    span: float | None = None,
    extras: bool = True,
    say: Progress | None = None,
    peers: bool = False,
) -> dict[str, Any]:
    """Measure what accuracy costs on a scene.

    Args:
        schemes: what to compare; all that run the scene unless given.
        dts: steps [s].
        span: time compared [s]; unless given, until a perturbation has grown 100 times, at most 20 s.
        extras: also the numerical damping, the claims on Euler's schemes and the convergence by link. Without them
            each scheme is run once, with its own solver in double precision, and steps that resist are not halved.
        peers: also rows of other simulators, where they are installed and can describe the scene.

    Returns:
        rows, orders, advice, reference, refused, skipped, for lines that stretch `loads` (see `load_convergence`), and
        the extras, as the command prints them.
    """
    say = say or silent
    model, s = build(scene, "float64")
    chosen, refused = runnable(default_schemes(model, not extras) if schemes is None else schemes, model)
    if not chosen:
        raise SceneError(f"--integrators: none runs this scene: {refused[0]['reason']}")
    say(0.0, "how long errors mean something")
    grid = max(dts)
    longest = max(min(scene.run.duration, LONGEST), 2 * grid)
    trusted, exponent = trusted_span(model, s, longest, min(scene.run.dt, grid), grid)
    saves = max(2, round(trusted / grid) if span is None else round(span / grid))
    say(0.1, f"reference over {saves * grid:.3g} s")
    target = reference(model, s, grid, saves, exponent)
    part = 0.4 if extras else 0.6
    rows, skipped = measure(
        model, s, chosen, list(dts), target, say=lambda f, text: say(0.2 + part * f, text), retry=extras
    )
    if peers:
        others, left = peer_rows(scene, model, s, target)
        rows, refused = rows + others, refused + left
    found = {
        "scene": scene.name,
        "rows": rows,
        "orders": orders(rows),
        "advice": advice(rows),
        "reference": {**target.summary(), "trusted_span_s": trusted},
        "refused": refused,
        "skipped": skipped,
    }
    if model.line.axial.elastic:
        found["loads"] = load_convergence(scene, dts, say=lambda f, text: say(0.6 + 0.1 * f, text))
    return {**found, **(_extras(model, s, target, dts, say) if extras else {})}


def _extras(model: Model, s: State, target: Reference, dts: tuple[float, ...], say: Progress) -> dict[str, Any]:
    say(0.7, "numerical damping")
    damping = numerical_damping()
    say(0.85, "Euler's schemes")
    claims = euler_claims()
    say(0.92, "convergence by link")
    return {
        "numerical_damping": damping,
        "euler": claims,
        "convergence": convergence(model, s, target.grid, len(target.t), list(dts)),
    }
