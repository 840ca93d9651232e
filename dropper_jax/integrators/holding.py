"""What friction does at the end of a step to joints that it held in the middle: it stops them.

A law on the mid-step rate holds a joint by `w_mid = 0`, which sends its rate w0 to `-w0`, for ever. So the end
velocities of such a step are changed by impulses P of the held joints (and of the tensions pi), within what friction
may give in a step:

    M delta = B' P + G' pi,    B (v1 + delta) = 0 on held joints,    |h z + P| <= h tau

In the mass metric that is a projection, so it takes kinetic energy and never gives any (Moreau 1988); what it takes
is work of the law. Where the bound is met the impulse stays on it, and the joint moves on.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from dropper_jax.kinematics import Kinematics, dot
from dropper_jax.system import Unknowns

if TYPE_CHECKING:
    from dropper_jax.model import Model

#: Passes over the bounds: impulses found on their bound in one are kept there in the next. A joint that comes to a
#: bound in the last pass keeps more than its share of one step, which costs accuracy of that event, never energy.
PASSES = 2
#: Compliance of the impulses, relative: held joints may be more than the motions they stop (8 joints, 5 motions of a
#: plane loop of 7 links), and then share the load in any way.
SHARING = 1e-10


def stop_held_joints(
    model: Model, z: tuple[jax.Array, ...], middle: Kinematics, after: Kinematics, h: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """End velocities (nodes, 3) [m/s] with held joints at rest, and the work of that (<= 0) [J].

    Args:
        z: the laws' unknowns over the step.
        middle, after: the middle and the end of the step.
        h: the step [s].
    """
    held = tuple(law.holding(middle, torque, h) for law, torque in zip(model.laws, z, strict=True))
    some = jnp.any(jnp.stack([jnp.any(one) for one in held]))
    stop = partial(_stop, model, h)
    keep = lambda after_v, *_: jnp.zeros_like(after_v)  # noqa: E731
    arguments = after.v, after.r, z, after.t
    delta = jax.lax.cond(some, lambda v, r, z, t: stop(held, v, r, z, t), keep, *arguments)
    return _falling(model, after, delta)


def stop_held_nodes(
    model: Model, z: tuple[jax.Array, ...], middle: Kinematics, after: Kinematics, h: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The same for laws that hold nodes one by one (`node_local`): each simply stops, as its `stop` says."""
    v1 = after.v
    for law, held in zip(model.laws, z, strict=True):
        v1 = law.stop(middle, v1, held, h)
    return v1, model.kinetic_energy(after.with_velocity(v1)) - model.kinetic_energy(after)


def _stop(model: Model, h: jax.Array, held: tuple[jax.Array, ...], v: Any, r: Any, z: Any, t: Any) -> jax.Array:
    after = model.kinematics(r, v, t)
    system = partial(_rows, model, after, after.with_velocity(jnp.zeros_like(v)))

    def again(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
        """One pass: solve, then keep on their bounds the impulses that went over them."""
        _, held, fixed = carry
        u = _linear_solve(partial(system, held, fixed), zero)
        allowed = tuple(h * law.admissible(p / h + q) - h * q for law, p, q in zip(model.laws, u.z, z, strict=True))
        over = tuple(
            one & jnp.any(jnp.abs(p - a) > 1e-9 * jnp.abs(a), axis=-1, keepdims=True)
            for one, p, a in zip(held, u.z, allowed, strict=True)
        )
        fixed = tuple(jnp.where(o, a, f) for o, a, f in zip(over, allowed, fixed, strict=True))
        return (u.x, tuple(one & ~o for one, o in zip(held, over, strict=True)), fixed), None

    zero = Unknowns(jnp.zeros_like(v), jnp.zeros_like(model.line.length), tuple(jnp.zeros_like(q) for q in z))
    return jax.lax.scan(again, (zero.x, held, zero.z), None, length=PASSES)[0][0]


def _rows(model: Model, after: Kinematics, still: Kinematics, held: Any, fixed: Any, u: Unknowns) -> Unknowns:
    """Rows of the system above for velocity changes, impulses of tensions and of joints."""
    line = model.line
    scale = jnp.mean(line.mass * line.length**2)
    moved = after.with_velocity(after.v + u.x)
    force = model.inertia(after, u.x) - model.pull(u.y, after.tangents)
    for law, p in zip(model.laws, u.z, strict=True):
        force = force - law.law_force(after, p)
    along = u.y
    if not line.axial.elastic:
        change = after.with_velocity(u.x).link_velocities - still.link_velocities
        rate = jnp.where(_both_held(model, held)[:, None], moved.link_velocities, change)
        along = jnp.mean(line.mass) * dot(after.tangents, rate)
    joints = tuple(
        jnp.where(one, scale * law.rates(moved) + SHARING * p, p - f)
        for law, one, p, f in zip(model.laws, held, u.z, fixed, strict=True)
    )
    return Unknowns(force, along, joints)


def _linear_solve(rows: Any, zero: Unknowns) -> Unknowns:
    """Where `rows`, linear in the unknowns, vanish."""
    flat, unravel = ravel_pytree(zero)
    constant = ravel_pytree(rows(zero))[0]
    columns = jax.vmap(lambda x: ravel_pytree(rows(unravel(x)))[0] - constant)(jnp.eye(len(flat), dtype=flat.dtype))
    return unravel(jnp.linalg.solve(columns.T, -constant))


def _both_held(model: Model, held: tuple[jax.Array, ...]) -> jax.Array:
    """Links (n,) whose two joints are held by one law: they stop whole, their rate of length too."""
    links = model.line.links
    both = jnp.zeros(links, bool)
    for one in held:
        if one.shape[0] > links:
            both = both | (one[:-1, 0] & one[1:, 0])
    return both


def _falling(model: Model, after: Kinematics, delta: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`v + s delta` with the s in [0, 1] of least kinetic energy (1 where delta is a projection), and its change."""
    weight = jnp.sum(delta * model.inertia(after, delta))
    slope = jnp.sum(delta * model.inertia(after, after.v))
    moves = weight > 0
    share = jnp.clip(-slope / jnp.where(moves, weight, 1.0), 0.0, 1.0)
    share = jnp.where(moves, share, 0.0)
    return after.v + share * delta, share * (slope + 0.5 * share * weight)
