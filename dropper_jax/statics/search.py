"""Search for the equilibrium: the stable one of dead loads, by Newton with load continuation, or by descent.

    F(r) + loads + sum of tensions = 0 on the free nodes,    axial law of every link = 0

The search runs on the host and needs only the scene; for derivatives see `static_pose`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from operator import itemgetter

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial import Rope
from dropper_jax.model import Model, State, state
from dropper_jax.statics.descent import (
    describe_unbalance,
    find_rest,
    find_softened,
    straight_guess,
    with_springs,
)
from dropper_jax.statics.equilibrium import Equilibrium, equilibrium_at
from dropper_jax.statics.loads import given_loads
from dropper_jax.statics.pose_stability import escape_unstable_equilibrium, is_stable, is_stable_or_planar
from dropper_jax.statics.rest_problem import rest, solve_statics, system_tolerance
from dropper_jax.statics.single_line import fall_from, follow_growing_loads, hang_and_solve
from dropper_jax.statics.static_friction import static_seabed_friction, with_static_seabed_friction

#: Message of an equilibrium that a small displacement ends.
UNSTABLE = "the equilibrium found is not stable: a small displacement lowers the potential energy"


def search(model: Model, loads: Array | None, t: float, near: State | None = None) -> Equilibrium:
    """The equilibrium of the model (see `static_pose.equilibrium`), solved on the host.

    The descent of a system of lines starts at `near`, if that is given, in place of straight lines.
    """
    double = jnp.result_type(float) == jnp.float64
    if double and model.dtype != jnp.float64:  # the balance of stiff links would be lost in rounding
        exact = search(model.cast(jnp.float64), loads, t, near)
        return replace(exact, state=state(model, exact.state.r, tension=exact.state.tension, t=t))
    full = model
    model = rest(model)
    loads = given_loads(model, loads)
    if not model.geometry.is_path:
        return _find_by_descent(full, model, loads, t, near)
    s, residual, message = _find_single_line(model, loads, t)
    if message and not model.line.compound:  # slack links, seabed or surface during the search
        lower = _find_by_descent(full, model, loads, t)
        better = is_stable_or_planar(model, lower.state) if lower.status == "ok" else lower.residual < residual
        if better:
            return lower
    return equilibrium_at(full, s, residual, message)


def _find_single_line(model: Model, loads: Array, t: float) -> tuple[State, float, str]:
    """The equilibrium of a single line, its maximum scaled row, and why it is not a stable one, else empty."""
    share = 1.0
    tolerance = system_tolerance(model)
    s, residual = hang_and_solve(model, loads, t)
    if not (residual <= tolerance and is_stable(model, s)):
        s, residual, share = follow_growing_loads(model, loads, t)
    if share == 1.0 and residual <= tolerance:
        s, residual = escape_unstable_equilibrium(model, s, residual, tolerance, partial(fall_from, model, loads))
    if share < 1.0 or not residual <= tolerance:
        return s, residual, describe_unbalance(model, s, share * loads, residual, f"beyond {share:.1%} of the loads")
    if not is_stable(model, s):
        return s, residual, UNSTABLE
    return s, residual, ""


def _find_by_descent(full: Model, model: Model, loads: Array, t: float, near: State | None = None) -> Equilibrium:
    """The equilibrium of `model`, the full one at rest, by descent from `near` or straight lines."""
    line = model.line
    is_rigid = not line.axial.elastic
    if is_rigid:
        model = with_springs(model)
    tolerance = system_tolerance(model)
    straight = straight_guess(model, t)
    s, residual = find_rest(model, near or straight, loads, tolerance)
    if not residual <= tolerance:
        s, residual = min((s, residual), find_softened(model, straight, loads, tolerance), key=itemgetter(1))
    message = ""
    if residual <= tolerance and _may_be_unstable(model, s):
        s, residual = _find_stable(model, s, residual, loads, tolerance)
        if _pushes(s) and not is_stable(model, s):
            message = UNSTABLE
    friction = static_seabed_friction(full)
    if residual <= tolerance and friction is not None:
        model, rounding = with_static_seabed_friction(model, s, friction.kinetic)
        tolerance = max(tolerance, float(rounding))
        s, residual = find_rest(model, s, loads, tolerance)
    if not residual <= tolerance:
        return equilibrium_at(full, s, residual, describe_unbalance(model, s, loads, residual, "by descent"))
    if is_rigid:
        s, residual = _find_rigid(replace(model, lines=(line,)), s, loads, tolerance)
        if not residual <= tolerance:
            message = f"no equilibrium of the rigid links found: maximum scaled row {residual:.1e}"
    return equilibrium_at(full, s, residual, message)


def _may_be_unstable(model: Model, s: State) -> bool:
    """Whether the result of a descent needs a check: links that push may buckle, slack ones drift in a current."""
    current = model.sea is not None and model.sea.current is not None
    is_slack = bool(np.any(np.asarray(s.tension) <= 0.0))
    return not model.constraints and (_pushes(s) or (current and is_slack))


def _pushes(s: State) -> bool:
    return bool(np.any(np.asarray(s.tension) < 0.0))


def _find_stable(model: Model, s: State, residual: float, loads: Array, tolerance: float) -> tuple[State, float]:
    """A stable equilibrium from the result of a descent; the same result if none is found.

    Straight lines of links that push are columns, which the descent from straight lines may keep: ropes in their place
    hang.
    """

    def find(at: State, _: float) -> tuple[State, float]:
        return find_rest(model, at, loads, tolerance)

    if _pushes(s) and not is_stable(model, s):
        ropes = model.with_axial(Rope(EA=model.line.axial.axial_stiffness()))
        hung, _ = find_rest(ropes, s, loads, tolerance)
        hung, size = find(hung, 0.0)
        if size <= tolerance:
            s = hung
            residual = size
    return escape_unstable_equilibrium(model, s, residual, tolerance, find)


def _find_rigid(model: Model, near: State, loads: Array, tolerance: float) -> tuple[State, float]:
    """The equilibrium of rigid links next to that of ropes in their place; a link that is slack there pushes here.

    If it is not found, or a small displacement ends it, the links also push during a further descent.
    """
    s, residual = solve_statics(model, near, loads)
    if residual <= tolerance and is_stable_or_planar(model, s):
        return s, residual
    bars = with_springs(model, pushes=True)

    def fall(start: State) -> tuple[State, float]:
        fallen, _ = find_rest(bars, start, loads, system_tolerance(bars))
        return solve_statics(model, fallen, loads)

    fallen, fallen_residual = fall(near)
    if not fallen_residual <= tolerance:
        return s, residual
    if is_stable_or_planar(model, fallen):
        return fallen, fallen_residual
    return escape_unstable_equilibrium(model, fallen, fallen_residual, tolerance, lambda start, _: fall(start))
