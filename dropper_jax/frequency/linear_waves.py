"""Motions and tensions in irregular waves about an equilibrium, by linear equations.

    (K + i w (C + D) - w^2 M) x = F + D u

K, C, M are the exact derivatives of all forces by positions, velocities and accelerations, as in
`dropper_jax.linearised`. F is the exact derivative of all forces by the amplitude of a wave component: Froude-Krylov
force, added mass, waterline, drag of the mean current, ends that follow the sea. u is the velocity of the waves. D is
the stochastic linearisation of the drag beyond its linear part, which C and F contain (`linear_drag`). It follows from
the velocities `i w x - u` of nodes relative to the waves. Positions and tensions shift by the static response to the
change of the mean force.

Nodes on the seabed have the stiffness of contact and, where they stick, of friction; sliding friction is left out.
Inextensible links are springs that stretch by 0.01 %.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.sparse.linalg import gmres

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.frequency.linear_drag import dragging_effects, iterate_drag, linear_drag, no_drag
from dropper_jax.model import Kinematics, Model, State
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.rest_problem import require_stretching_links, rest
from dropper_jax.statics.static_friction import static_seabed_friction, with_static_seabed_friction
from dropper_jax.statics.tangent import Linear, Tangent, solve_matrix


class LinearMotion(NamedTuple):
    """Stiffness, damping and mass in the form of the tangent, and derivatives of tensions by link vectors and their
    rates (n, 3)."""

    stiffness: Array
    damping: Array
    mass: Array
    stretch: Array
    stretch_rate: Array


class WaveLoads(NamedTuple):
    """Complex amplitudes by component: forces (c, free, 3) [N], tensions from moving ends (c, n) [N], and velocities of
    the water (c, free, 3) [m/s]."""

    force: Array
    tension: Array
    flow: Array


def check_no_bodies(model: Model) -> None:
    """Reject rigid bodies: in a trial the tension of `ballasted-spar` was 14 % above that of a run, 10 % allowed.

    A spar on two tethers was within 5 % with 40 and 120 components, and 13 to 21 % low with 8. Likely cause: a
    resonance in one component moves as a sine, whose linearised drag is 25 % less than that of a normal process.
    """
    if model.constraints:
        raise SceneError("body: rigid bodies are not accurate in the frequency domain. Use a run in time")


def still_model(model: Model, pose: State) -> Model:
    """The model without waves whose tangent is used, with the friction that holds its equilibrium."""
    still = rest(model)
    friction = static_seabed_friction(model)
    if friction is None:
        return still
    return with_static_seabed_friction(still, pose, friction.kinetic)[0]


def _force(model: Model, k: Kinematics, tension: Array) -> Array:
    """All forces on the nodes (free, 3) at an instant, with tensions along the links."""
    direction = model.line.axial.direction(k.links, k.links, k.links, model.line.length)
    return model.force(k) + model.tension_force(tension, direction)


@cached_jit()
def linearise(still: Model, pose: State) -> LinearMotion:
    """The matrices about an equilibrium without waves."""
    line = still.line
    none = jnp.zeros_like(pose.r)
    ends = still.ends(pose.t)

    def rows(x: Array, v: Array, a: Array) -> Array:
        k = still.instant(pose.r + x, v, pose.t, ends)
        return still.inertia(k, a) - _force(still, k, still.tension_by_law(k))

    linear = jax.linearize(rows, none, none, none)[1]
    tangent = Tangent.of(still)

    def matrix_of(shares: Array) -> Array:
        """The matrix by these shares (3,) of displacement, velocity and acceleration."""
        return tangent.matrix(lambda d: linear(shares[0] * d, shares[1] * d, shares[2] * d), none)

    def total_tension(link: Array, rate: Array) -> Array:
        return jnp.sum(line.axial.tension(link, rate, line.length))

    links = still.links(pose.r, ends)
    stiffness, damping, mass = jax.vmap(matrix_of)(jnp.eye(3))
    stretch, stretch_rate = jax.grad(total_tension, argnums=(0, 1))(links, jnp.zeros_like(links))
    return LinearMotion(stiffness, damping, mass, stretch, stretch_rate)


def _components(waves: Waves, together: bool) -> Waves:
    """Each component as waves, with a leading axis; `together`: as all components, of which one has an amplitude."""
    size = waves.size
    if together:
        each = jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *x.shape)), waves)
        return replace(each, amplitude=jnp.diag(waves.amplitude))
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (size,))[:, None], replace(waves, ramp=None))


def wave_loads(model: Model, pose: State, waves: Waves) -> WaveLoads:
    """The loads of all components; the model is without waves."""
    # effects that know every component of the waves
    each = _components(replace(waves, ramp=None), model.effect("vessel_motion") is not None)
    of_components = jax.vmap(partial(_loads_at_phase, model, pose), (0, None))
    # a quarter period later by the phase: Re(H exp(i w t)) there is -Im(H)
    both = jax.vmap(of_components, (None, 0))(each, jnp.array([0.0, -0.5 * jnp.pi]))
    return WaveLoads(*(now - 1j * later for now, later in both))


def _loads_at_phase(model: Model, pose: State, component: Waves, phase_shift: Array) -> tuple[Array, ...]:
    """Forces (free, 3) [N], tensions (n,) [N] and velocities of the water (free, 3) [m/s] at one instant, linear in the
    amplitude of a component, whose phase is shifted."""
    still = jnp.zeros_like(pose.r)

    def loads(amplitude: Array) -> tuple[Array, ...]:
        shifted = replace(component, amplitude=amplitude, phase=component.phase + phase_shift)
        sea = replace(model.sea, waves=shifted)
        moved = replace(model, sea=sea)
        k = moved.instant(pose.r, still, pose.t)
        tension = moved.tension_by_law(k)
        inertia = moved.inertia(k, still, moved.end_acceleration(pose.t))
        return _force(moved, k, tension) - inertia, tension, sea.at(pose.r, pose.t).velocity

    return jax.jvp(loads, (jnp.zeros_like(component.amplitude),), (component.amplitude,))[1]


def tension_changes(model: Model, linear: LinearMotion, x: Array, v: Array) -> Array:
    """Changes of the tensions (k, n) [N] at displacements and velocities (k, free, 3)."""
    links = jax.vmap(lambda y: model.link_rates(y, None))
    return jnp.sum(linear.stretch * links(x) + linear.stretch_rate * links(v), axis=-1)


def respond(model: Model, linear: LinearMotion, drag: Array, loads: WaveLoads, omega: Array) -> Array:
    """Displacements (c, free, 3) by the full equations."""
    tangent = Tangent.of(model)

    def times(d: Array, x: Array) -> Array:
        """Matrices (free, 3, 3) times vectors (..., free, 3)."""
        return jnp.einsum("nij,...nj->...ni", d, x)

    extra = tangent.matrix(partial(times, drag[0] + drag[1]), jnp.zeros_like(loads.force[0].real))

    def solve(w: Array, b: Array) -> Array:
        matrix = linear.stiffness + 1j * w * (linear.damping + extra) - w**2 * linear.mass
        return solve_matrix(tangent, matrix, b)

    return jax.vmap(solve)(omega, loads.force + times(drag[0], loads.flow))


def static_shift(model: Model, linear: LinearMotion, omega: Array, force: Array) -> Array:
    """Displacement (free, 3) under a constant force."""
    return solve_matrix(Tangent.of(model), static_matrix(linear, omega), force)


#: Static shifts with a stiffness of 1e-4 of the inertia: a slack line on the bed has none across itself.
BED_STIFFNESS = 1e-4


def static_matrix(linear: LinearMotion, omega: Array) -> Array:
    """The stiffness of static shifts; `omega`: frequencies of the waves (...) [rad/s]."""
    return linear.stiffness + BED_STIFFNESS * jnp.min(omega) ** 2 * linear.mass


def _krylov(linear: Linear, b: Array) -> Array:
    """The solution of `linear(x) = b`; a change of D changes itself by less than its size, so GMRES needs few steps."""
    return gmres(linear, b, tol=1e-12, restart=60, maxiter=4, solve_method="batched")[0]


def tension_deviation(model: Model, pose: State) -> tuple[Array, Array]:
    """Mean and standard deviation of all tensions (n,) [N] in the irregular waves of the model, by the full equations.

    Differentiable in model and configuration, forward and reverse: the linearised drag D = g(D) has the derivative
    `(1 - g_D)^-1 g_theta` (implicit function theorem). Use the configuration of `equilibrium` of the same model, which
    has the required derivatives. It may be compiled with `jax.jit`.

    Args:
        pose: `equilibrium(...).state`.

    Raises:
        SceneError: rigid links or bodies, or no irregular waves.
    """
    check_no_bodies(model)
    require_stretching_links(model)
    waves = None if model.sea is None else model.sea.waves
    if waves is None or waves.size < 2:
        raise SceneError("sea.waves: is not an irregular linear sea. Use kind 'spectrum'")
    still = still_model(model, pose)
    linear = linearise(still, pose)
    dragging = dragging_effects(still)
    of_waves = wave_loads(still, pose, waves)
    rate = 1j * waves.omega[:, None, None]

    def drag_of(drag: Array, number: Array | None = None) -> tuple[Array, Array]:
        x = respond(still, linear, drag, of_waves, waves.omega)
        if number is not None:
            x = jnp.where(number > 0, x, 0.0)
        return linear_drag(dragging, pose, rate * x, of_waves.flow)

    # derivatives follow from the fixed point itself, so it is solved to rounding
    drag = jax.lax.custom_root(
        lambda drag: drag_of(drag)[0] - drag,
        no_drag(pose),
        lambda _, start: jax.lax.stop_gradient(iterate_drag(drag_of, start, 1e-12)[0]),
        lambda linear, b: jax.lax.custom_linear_solve(linear, b, _krylov, _krylov),
    )
    x = respond(still, linear, drag, of_waves, waves.omega)
    _, shift = drag_of(drag)
    tension = tension_changes(still, linear, x, rate * x) + of_waves.tension
    moved = static_shift(still, linear, waves.omega, shift)[None]
    mean = pose.tension + tension_changes(still, linear, moved, jnp.zeros_like(moved))[0]
    return mean, jnp.sqrt(0.5 * jnp.sum(jnp.abs(tension) ** 2, axis=0))
