"""The default: midpoint forces, constraint at the end of the step, tensions along the mid-step link.

    v_mid = (r1 - r0)/h,  v1 = v0 + (v_mid - v0)/gamma,  r_gamma = (1 - gamma) r0 + gamma r1
    M (v1 - v0)/h - F(r_gamma, v_mid, t + gamma h) - sum T_j d_gamma/length = 0,    axial law at r1 = 0

With gamma = 1/2 the work of the tensions is exactly `T (|d1| - |d0|)`, and that of constant forces and weights exactly
the change of their potential. Energy is therefore conserved to rounding error with no numerical damping (Gonzalez 1996;
Simo and Tarnow 1992).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.axial import LinkStart
from dropper_jax.integrators.consistent_velocities import (
    initial_velocity,
    points_jump,
    sawtooth_grows,
    velocities_after_jump,
    velocities_after_step_change,
)
from dropper_jax.integrators.stop_stuck import stop_stuck_joints, stop_stuck_nodes
from dropper_jax.model import (
    MOVING_ENDS,
    AddedMass,
    Ends,
    Kinematics,
    Model,
    State,
    Works,
    book_works,
    non_conservative_forces,
    turning_work_name,
)
from dropper_jax.residual import DisplacementProblem, Implicit, LocalError, NodeRows, PerLaw, Unknowns


@dataclass(frozen=True)
class EnergyMomentum(Implicit):
    """Energy-momentum midpoint scheme, second order."""

    name = "energy_momentum"
    order = 2
    condensable = True
    networkable = True
    takes_laws = True
    takes_constraints = True
    tension_time = 0.5

    @property
    def weighting(self) -> float:
        """Weight of the new time."""
        return 0.5

    @property
    def local_error(self) -> LocalError | None:
        """The mean acceleration of a step is that of its middle: `h^3 (1/4 - 1/6)` of the third derivative."""
        if self.weighting != 0.5 or len(self.stages) > 1:
            return None
        return LocalError(constant=1.0 / 12.0, lag=-0.5, inertia=2.0)

    def begin(self, model: Model, s: State) -> State:
        """The state with velocities that are consistent with links between moving ends."""
        if model.has_moving_ends:
            return replace(s, v=initial_velocity(model, s.r, s.v, s.t))
        return s

    def change_step(self, model: Model, s: State, h: Array) -> State:
        v, _ = velocities_after_step_change(
            model.instant(s.r, s.v, s.t), s.acceleration, model.end_acceleration(s.t), h
        )
        return replace(s, v=v)

    def equations(self, model: Model, s: State, h: Array) -> MidpointProblem:
        return MidpointProblem(model, s, h, self.weighting, alone=len(self.stages) == 1)


#: Square of the sawtooth's speed divided by that of the fastest link, above which a step ends with the projection.
RINGING_SPEED = 1e-3


class MidpointProblem(DisplacementProblem):
    """Unknowns: x = r1 - r0 - h v0, tensions, law unknowns.

    `alone` means that steps of equal length follow each other. The steps of a composition do not, and a smooth motion
    has a different rate of stretch at their ends.
    """

    def __init__(self, model: Model, s: State, h: Array, gamma: float | Array, alone: bool) -> None:
        super().__init__(model, s, h)
        model = self.model
        self.gamma = gamma
        self.alone = alone
        self.t_mid = s.t + gamma * h
        ends0 = self.ends0
        ends1 = self.ends1
        self.ends = ends1
        self.end_acceleration = None
        if ends0.velocities is not None and ends1.velocities is not None:
            middle = (1 - gamma) * ends0.positions + gamma * ends1.positions
            moved = ends1.positions - ends0.positions
            self.ends = Ends(middle, moved / h)
            self.end_acceleration = (ends1.velocities - ends0.velocities) / h
            self.end_mean_velocity = 0.5 * (ends0.velocities + ends1.velocities)
        self.start = self._link_start()
        self.prepared = model.prepare(model.kinematics(s.r + gamma * h * s.v, s.v, self.t_mid, self.ends))

    def _link_start(self) -> LinkStart:
        """The links at the start of the step, with what the laws of those that stretch need of them."""
        model = self.model
        if model.line.axial.rigid(model.line.links).all():
            return LinkStart(self.links0, None)
        rate = model.link_rates(self.s.v, self.ends0)
        if not self.alone:  # the last step has another length, and may go backwards
            return LinkStart(self.links0, rate)
        acceleration = model.geometry.differences(self.s.acceleration, self.end_acceleration)
        return LinkStart(self.links0, rate, acceleration, model.inverse_reduced_mass)

    def guess(self) -> Unknowns:
        s = self.s
        return Unknowns(s.acceleration * (self.gamma * self.h**2), s.tension, s.law)

    def instant(self, x: Array) -> Kinematics:
        s = self.s
        h = self.h
        v = s.v + x / h
        r = s.r + self.gamma * h * v
        return self.model.kinematics(r, v, self.t_mid, self.ends, self.prepared, h=h, before=s.v)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        middle = self.instant(x)
        a = x / (self.gamma * self.h**2)
        force = self.model.inertia(middle, a, self.end_acceleration) - self.model.force(middle)
        if not z:
            return force, ()
        of_unknowns, rows = self._law_and_constraint_rows(middle, z)
        return force - of_unknowns, rows

    def _directions(self, links1: Array) -> Array:
        """Directions (n, 3) of the tension forces over the step, whose end has the links (n, 3) [m]."""
        mean = (1 - self.gamma) * self.links0 + self.gamma * links1
        line = self.model.line
        return line.axial.direction(self.links0, links1, mean, line.length)

    def _law_and_constraint_rows(self, k: Kinematics, z: PerLaw) -> NodeRows:
        """Forces (nodes, 3) [N] of the unknowns of laws and constraints, and the rows that determine them.

        Multipliers act along the gradient at the middle of the step (gamma may be another time), gaps vanish at its
        end.
        """
        model = self.model
        force, rows = self.law_rows(k, z)
        middle = k.r + (0.5 - self.gamma) * self.h * k.v
        end = k.r + (1.0 - self.gamma) * self.h * k.v
        for constraint, multipliers in zip(model.constraints, z[len(rows) :], strict=True):
            force = force + constraint.constraint_force(model, middle, multipliers)
            rows = (*rows, constraint.gap(model, end))
        return force, rows

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        line = self.model.line
        return y[:, None] * self._directions(d), line.axial.residual(self.start, d, y, line.length, self.h)

    def finish(self, u: Unknowns) -> State:
        h = self.h
        r1 = self.end_positions(u.x)
        v1, stopped = self._end_velocity(u, r1)
        v1, impulse, struck = self._after_jumps(r1, v1)
        tension = u.y
        if impulse is not None:
            tension = tension + impulse / h
        return self.end_state(
            r=r1,
            v=v1,
            tension=tension,
            acceleration=u.x / (self.gamma * h**2),
            law=jax.lax.stop_gradient(u.z),
            work=lambda: self._work(u, stopped, struck),
        )

    def _end_velocity(self, u: Unknowns, r1: Array) -> tuple[Array, Works]:
        """Velocity (nodes, 3) [m/s] at the end, and the energy taken by stopping stuck joints or nodes, by name [J]."""
        h = self.h
        model = self.model
        v1 = self.s.v + u.x / (self.gamma * h)
        if not model.laws:
            return v1, {}
        middle = self.instant(u.x)
        after = model.kinematics(r1, v1, self.s.t + h, self.ends1, prepared=self.prepared)
        stop = stop_stuck_joints
        if all(law.node_local for law in model.laws):
            stop = stop_stuck_nodes
        v1, taken = stop(model, u.z[: len(model.laws)], middle, after, h)
        return v1, {model.laws[0].name: taken}

    def _after_jumps(self, r1: Array, v1: Array) -> tuple[Array, Array | None, Works]:
        """End velocities consistent with rigid links, if prescribed points jumped; impulses (n,) [N s] and their
        work."""
        model = self.model
        jumped = points_jump(model, self.s.t, self.h)
        grows = sawtooth_grows(model)
        if grows is not None and self.alone and self.gamma == 0.5:  # a shifted midpoint damps it
            rings = grows & (self._sawtooth(r1, v1) > RINGING_SPEED**2)
            if jumped is not None:
                rings = jumped | rings
            jumped = rings
        if jumped is None:
            return v1, None, {}

        def project() -> tuple[Array, ...]:
            t1 = self.s.t + self.h
            k = model.instant(r1, v1, t1, self.ends1)
            v, impulse = velocities_after_jump(k, model.end_acceleration(t1), self.h)
            return v, impulse, model.kinetic_energy(k.with_velocity(v)) - model.kinetic_energy(k)

        unchanged = v1, jnp.zeros_like(self.s.tension), jnp.zeros((), v1.dtype)
        v, impulse, gained = jax.lax.cond(jumped, project, lambda: unchanged)
        name = MOVING_ENDS
        if not model.has_moving_ends:  # it is the work of what excites the sawtooth
            name = turning_work_name(model.effects_with(AddedMass)[0])
        return v, impulse, {name: gained}

    def _sawtooth(self, r1: Array, v1: Array) -> Array:
        """Maximum rate of stretch that changes sign at every step, divided by the fastest link's speed, a scalar."""
        model = self.model
        h = self.h
        k = model.kinematics(r1, v1, self.s.t + h, self.ends1)
        change = model.geometry.differences((v1 - self.s.v) / h, self.end_acceleration)
        rate = jnp.sum(k.links * k.link_velocities, -1) - 0.25 * h**2 * jnp.sum(k.link_velocities * change, -1)
        fastest = jnp.max(jnp.sum(k.link_velocities**2, -1))
        return jnp.max((rate / k.line.length) ** 2) / jnp.maximum(fastest, jnp.finfo(v1.dtype).tiny)

    def _work(self, u: Unknowns, stopped: Works, struck: Works) -> Array:
        """Work (k,) [J] over the step, in the order of `work_names`."""
        model = self.model
        line = model.line
        h = self.h
        k = self.instant(u.x)
        links1 = self.link_vectors(u.x)
        forces = non_conservative_forces(model, k)
        for law, z in zip(model.laws, u.z, strict=False):  # multipliers of constraints do no work
            forces[law.name] = forces.get(law.name, 0.0) + law.law_force(k, z)
        works = {name: h * jnp.sum(force * k.v) for name, force in forces.items()}
        turned = {turning_work_name(e): self._turning(e, k, u) for e in model.effects_with(AddedMass)}
        ends = self._end_works(u, self._directions(links1), k)
        axial = line.axial.works(self.start, links1, line.length, h)
        drums = line.axial.drum_works(self.links0, links1, u.y)
        return book_works(model, works, stopped, struck, turned, axial, drums, ends)

    def _turning(self, effect: AddedMass, k: Kinematics, u: Unknowns) -> Array:
        """Energy [J] that added mass gains by turning: change of its kinetic energy minus the work against its inertia.

        `1/2 v' M_a' v` over the step, in the form that closes the balance to rounding error.
        """
        model = self.model
        s = self.s
        h = self.h
        x = u.x
        before = model.kinematics(s.r, s.v, s.t, self.ends0)
        after = model.kinematics(self.end_positions(x), s.v + x / (self.gamma * h), s.t + h, self.ends1)
        spent = h * jnp.sum(k.v * effect.inertia(k, x / (self.gamma * h**2)))
        return effect.kinetic(after) - effect.kinetic(before) - spent

    def _end_works(self, u: Unknowns, directions: Array, k: Kinematics) -> Works:
        """Work [J] of moving ends by name: the force that holds each end (own weight aside) times its velocity."""
        line = self.model.line
        works = self.end_works(u.y[:, None] * directions, self.ends, k=k)
        if not (line.compound and works):
            return works
        # the force that accelerates the links' masses at the end, times the mean of the end's velocities: exactly the
        # change of their kinetic energy, while tensions work along the end's path
        a = u.x / (self.gamma * self.h**2)
        hold = line.geometry.held_at_ends(*line.inertia_forces(a, self.end_acceleration))
        return {**works, MOVING_ENDS: works[MOVING_ENDS] + self.h * jnp.sum(hold * self.end_mean_velocity)}
