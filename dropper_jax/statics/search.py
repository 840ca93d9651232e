"""Search for the equilibrium: the stable one of dead loads, by Newton with load continuation, or by descent.

    F(r) + loads + sum of tensions = 0 on the free nodes,    axial law of every link = 0

The search runs on the host and needs only the scene; for derivatives see `static_pose`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial import Rope
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.seabed_friction import SeabedFriction
from dropper_jax.effects.weight import Weight
from dropper_jax.model import Ends, Model, State, state
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.catenary import catenary_guess
from dropper_jax.statics.dead_loads import hang_under_loads
from dropper_jax.statics.descent import (
    describe_unbalance,
    find_rest,
    find_softened,
    straight_guess,
    with_springs,
)
from dropper_jax.statics.pose_stability import escape_unstable_equilibrium, is_stable, is_stable_or_planar
from dropper_jax.statics.rest_problem import polish, rest, solve_statics, system_tolerance
from dropper_jax.statics.static_friction import with_static_seabed_friction


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["positions", "tension", "residual", "state"],
    meta_fields=["status", "message"],
)
@dataclass(frozen=True)
class Equilibrium:
    """A static equilibrium; a traced one contains traced arrays.

    Attributes:
        positions: nodes (n + 1, 3) [m]; of a system those of all lines, line after line.
        tension: links (n,) [N].
        residual: maximum scaled row.
        status: `ok` or `not_converged`; `traced` inside JAX's transformations, in which a failed search gives NaN.
        message: the reason of a failure, else empty.
        state: the equilibrium as a `State` at rest.
    """

    positions: np.ndarray
    tension: np.ndarray
    residual: float
    status: str
    message: str
    state: State = field(repr=False)


#: Message of an equilibrium that a small displacement ends.
UNSTABLE = "the equilibrium found is not stable: a small displacement lowers the potential energy"


def given_loads(model: Model, loads: Array | None) -> Array:
    """Loads (free nodes, 3) [N] of the nodes; zero without any."""
    if loads is None:
        return jnp.asarray(np.zeros((model.free_nodes, 3)), model.dtype)
    return jnp.asarray(loads, model.dtype)


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
        return _by_descent(full, model, loads, t, near)
    share = 1.0
    message = ""
    tolerance = system_tolerance(model)
    s, residual = _hang_and_solve(model, loads, t)
    if not (residual <= tolerance and is_stable(model, s)):
        s, residual, share = _continue(model, loads, t)
    if share == 1.0 and residual <= tolerance:
        s, residual = escape_unstable_equilibrium(model, s, residual, tolerance, partial(_fall, model, loads))
    if share < 1.0 or not residual <= tolerance:
        message = describe_unbalance(model, s, share * loads, residual, f"beyond {share:.1%} of the loads")
    elif not is_stable(model, s):
        message = UNSTABLE
    if message and not model.line.compound:  # slack links, seabed or surface during the search
        lower = _by_descent(full, model, loads, t)
        better = is_stable_or_planar(model, lower.state) if lower.status == "ok" else lower.residual < residual
        if better:
            return lower
    return _result(full, s, residual, message)


def _by_descent(full: Model, model: Model, loads: Array, t: float, near: State | None = None) -> Equilibrium:
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
    friction = outward(full)
    if residual <= tolerance and friction is not None:
        model, rounding = with_static_seabed_friction(model, s, friction.kinetic)
        tolerance = max(tolerance, float(rounding))
        s, residual = find_rest(model, s, loads, tolerance)
    if not residual <= tolerance:
        return _result(full, s, residual, describe_unbalance(model, s, loads, residual, "by descent"))
    if is_rigid:
        s, residual = _find_rigid(replace(model, lines=(line,)), s, loads, tolerance)
        if not residual <= tolerance:
            message = f"no equilibrium of the rigid links found: maximum scaled row {residual:.1e}"
    return _result(full, s, residual, message)


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


#: Corrections of the descent from an unstable equilibrium.
FALL_ITERATIONS = 80


def _fall(model: Model, loads: Array, s: State, stiffness: float) -> tuple[State, float]:
    """The equilibrium reached by descent from `s`, next to one with a (negative) stiffness [N/m]."""
    kappa = jnp.asarray(4.0 * abs(stiffness), model.dtype)
    fallen, _ = polish(model, s, loads, kappa, iterations=FALL_ITERATIONS, damped=False)
    return solve_statics(model, fallen, loads)


def outward(full: Model) -> SeabedFriction | None:
    """The static seabed friction of the lines of a system, or None."""
    friction = full.effect("seabed_friction")
    alone = full.geometry.is_path or full.constraints
    if isinstance(friction, SeabedFriction) and friction.statics == "outward" and not alone:
        return friction
    return None


#: Number of times that a line hangs again, under the forces at its last configuration.
REHANGINGS = 4


def _hang_and_solve(model: Model, loads: Array, t: float) -> tuple[State, float]:
    """The stable equilibrium under the forces on a straight guess, updated if they depend on the configuration."""
    s = _hang(model, loads, None, t)
    if not model.constant_force:
        for _ in range(REHANGINGS):
            s = _hang(model, loads, s.r, t)
    return solve_statics(model, s, loads)


def _host_ends(ends: Ends) -> tuple[np.ndarray, np.ndarray | None]:
    """Start and end (3,) [m] of a line on the host; None for a free end."""
    end = None if ends.end is None else np.asarray(ends.end, float)
    return np.asarray(ends.start, float), end


def _hang(model: Model, loads: Array, r: Array | None, t: float) -> State:
    """The equilibrium under the forces at the positions r, as dead loads."""
    line = model.line
    ends, force = _forces(model, r, jnp.asarray(t, model.dtype))
    total = np.asarray(force, float) + np.asarray(loads, float)
    if not np.any(total):
        raise SceneError(
            "start.kind: 'static' needs a load that gives the line its shape; add [effects.weight] or start from "
            "'angles' or 'positions'"
        )
    flexibility = np.zeros(line.links)
    if line.axial.elastic:
        flexibility += 1.0 / line.axial.axial_stiffness()
    nodes, tension = hang_under_loads(*_host_ends(ends), np.asarray(line.length, float), total, flexibility)
    return state(model, nodes, tension=tension, t=t)


@cached_jit()
def _forces(model: Model, r: Array | None, t: Array) -> tuple[Ends, Array]:
    """The fixed ends, and the forces (free nodes, 3) [N] on nodes at rest at positions r, or at the start of the
    line."""
    ends = model.ends(t)
    if r is None:
        r = jnp.broadcast_to(ends.start, (model.free_nodes, 3))
    return ends, model.force(model.instant(r, jnp.zeros_like(r), t, ends))


#: First and minimum load increment of the continuation, as fractions of the loads.
FIRST_INCREMENT = 1.0 / 8
MIN_INCREMENT = 1.0 / 1024
#: Displacement of a node, over the length of the line, at which an increment may have jumped to another branch.
JUMP_DISPLACEMENT = 0.5


def _continue(model: Model, loads: Array, t: float) -> tuple[State, float, float]:
    """Load continuation from the catenary; returns the fraction of the loads that was reached."""
    s, residual = solve_statics(model, _catenary(model, t), jnp.zeros_like(loads))
    if not np.any(np.asarray(loads)):
        return s, residual, 1.0
    share = 0.0
    increment = FIRST_INCREMENT
    tolerance = system_tolerance(model)
    while residual <= tolerance and share < 1.0 and increment >= MIN_INCREMENT:
        step = min(increment, 1.0 - share)
        trial, trial_residual = solve_statics(model, s, (share + step) * loads)
        jumps = jnp.max(jnp.abs(trial.r - s.r)) >= JUMP_DISPLACEMENT * jnp.sum(model.line.length)
        if trial_residual <= tolerance and not jumps:
            s = trial
            residual = trial_residual
            share += step
            increment = 2.0 * step
        else:
            increment = step / 2.0
    return s, residual, share


def _catenary(model: Model, t: float) -> State:
    """The line at time t as a catenary under its weight."""
    ends = model.ends(jnp.asarray(t, model.dtype))
    line = model.line
    weight = model.effect("weight")
    links = weight.per_link(line) if isinstance(weight, Weight) else GRAVITY_SCALE * line.mass
    total = float(jnp.sum(links))
    nodes, tension = catenary_guess(*_host_ends(ends), np.asarray(line.length, float), total)
    return state(model, nodes[1 : 1 + model.free_nodes], tension=tension, t=t)


@cached_jit()
def node_positions(model: Model, s: State) -> Array:
    """Positions of all nodes (n + 1, 3) [m]."""
    return model.nodes(s.r, model.ends(s.t))


def _result(model: Model, s: State, residual: float, message: str) -> Equilibrium:
    """The equilibrium; a `message` is the reason of a failure."""
    s = state(model, s.r, tension=s.tension, t=s.t)
    return Equilibrium(
        positions=np.asarray(node_positions(model, s)),
        tension=np.asarray(s.tension),
        residual=residual,
        status="not_converged" if message else "ok",
        message=message,
        state=s,
    )
