"""Inertia of the water (Morison): Froude-Krylov force, and added mass on both sides of the equation of motion."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.read import Values
from dropper_jax.effects.coefficient_source import SOURCES, check_source
from dropper_jax.effects.submerged import split, wet_share
from dropper_jax.model import Effect, Kinematics, LinkEnd
from dropper_jax.scene import SceneData


class _InertiaForce(Effect):
    """The force on the right-hand side, with the coefficients of the subclass."""

    @property
    def fluid_acceleration(self) -> str:
        """`local` or `material`."""
        raise NotImplementedError

    @property
    def needs_material(self) -> bool:
        return self.fluid_acceleration == "material"

    def _coefficients(self, k: Kinematics) -> tuple[Array | float, Array | float]:
        return 0.0, 0.0

    def _wet_mass(self, k: Kinematics, end: LinkEnd) -> Array:
        """Mass of the water displaced by the submerged ends of links (n, 1) [kg]."""
        wet = wet_share(k, end, k.water.tangents, k.water.motion.elevation)
        return (k.sea.density * k.line.volume * end.share * wet)[:, None]

    def force(self, k: Kinematics) -> Array:
        water = k.water
        change = water.motion.acceleration
        if self.needs_material and water.material is not None:
            change = water.material
        total = jnp.zeros_like(k.r)
        for end in k.line.link_ends():
            across, along = split(end.at(change), water.tangents)
            can, cat = self._coefficients(k)
            total = total + end.collect(self._wet_mass(k, end) * ((1.0 + can) * across + (1.0 + cat) * along))
        return total


@component
class FroudeKrylov(_InertiaForce):
    """`rho V w u'`: `morison_inertia` without added mass, which avoids the cost of added mass."""

    name = "morison_inertia"
    needs_water = True
    fluid_acceleration: str = option("of the water", choices=("local", "material"), default="local")


@component
class MorisonInertia(_InertiaForce):
    """Force `rho V w (1 + C) u'` on the right and added mass `M_a = rho V w C` on the left, across and along the links.

    (Paper (1) with (18) would count the added mass twice; thesis (6.12) has `C_M (u' - v')` for `C_M u' - C_A v'`:
    errata.) C_A is `can` across and `cat` along a link; `fluid_acceleration` is the local du/dt or the material Du/Dt.
    A line with an `outer_diameter` D has the added mass of `pi/4 D^2`, and the Froude-Krylov force of V. Without `can`
    and `cat` there is no added mass: the effect is then `FroudeKrylov`.

    `coefficients` computes can per link from the flow of the linear sea, fixed for the run (see
    `modelling.flow_coefficients`).

    If can and cat differ, added mass turns with its link. `added_mass = "morison"` uses the force `M_a v'`, which is
    not conservative: its power `1/2 v' M_a' v` is the entry `morison_inertia_turning` of the energy balance.
    `"lagrangian"` uses `d/dt(M_a v) - 1/2 d(v' M_a v)/dr`, which conserves energy: with `M_a = a + b d d'/L^2`,

        (p1 - p0)/h + (force of the links f),    f = b/(2 L^2) (v0 (d . v1) + v1 (d . v0)),    d mid-step,

    does work that is exactly the change of `1/2 v' M_a v` (a discrete gradient).
    """

    name = "morison_inertia"
    needs_water = True
    can: Array = parameter("added mass coefficient across the link", unit="-", shape="link", low=0.0, default=None)
    cat: Array = parameter("added mass coefficient along the link", unit="-", shape="link", low=0.0, default=None)
    fluid_acceleration: str = option("of the water", choices=("local", "material"), default="local")
    table_kc: Array | None = parameter("KC of the table, rising", unit="-", shape="table", low=0.0, default=None)
    table_can: Array | None = parameter(
        "added mass coefficients of the table at `table_kc`", unit="-", shape="table", low=0.0, default=None
    )
    table_re: Array | None = parameter("minimum and maximum Re of the table", unit="-", shape="table", default=None)
    added_mass: str = option(
        "force of added mass that turns with its link", choices=("morison", "lagrangian"), default="morison"
    )
    coefficients: str = option("source of can", choices=SOURCES, default="given")

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        check_source("effects.morison_inertia", values, "can", "added mass coefficient across the link")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        arguments = {key: values[key] for key in ("can", "cat", "fluid_acceleration", "added_mass")}
        if values["coefficients"] != "given":  # until the flow is known
            arguments["can"] = np.ones(scene.line.links)
        if arguments["can"] is None and arguments["cat"] is None:
            return FroudeKrylov(fluid_acceleration=values["fluid_acceleration"])
        for key in ("can", "cat"):
            if arguments[key] is None:
                arguments[key] = 0.0
        return cls(**arguments)

    @property
    def reach(self) -> int:
        return int(self.added_mass == "lagrangian")

    @property
    def may_gain_energy(self) -> bool:
        """Whether added mass may gain energy by turning, as in Morison's form if can and cat differ."""
        return self.added_mass == "morison"

    def gains_energy(self) -> Array:
        """Whether can and cat actually differ anywhere."""
        return jnp.any(self.can != self.cat)

    def _coefficients(self, k: Kinematics) -> tuple[Array, Array]:
        """C_A across and along over the displaced mass, ready to multiply (n, 3)."""
        can = _per_link(self.can)
        cat = _per_link(self.cat)
        if k.line.outer_diameter is None:
            return can, cat
        size = ((k.line.outer_diameter / k.line.needed_diameter) ** 2)[:, None]
        return size * can, size * cat

    def inertia(self, k: Kinematics, a: Array) -> Array:
        """Inertia force (nodes, 3) [N] of the added mass for accelerations a."""
        if self.added_mass == "lagrangian":
            return self._conservative_inertia(k, a)
        total = jnp.zeros_like(a)
        can, cat = self._coefficients(k)
        for end in k.line.link_ends():
            across, along = split(end.at(a), k.water.tangents)
            total = total + end.collect(self._wet_mass(k, end) * (can * across + cat * along))
        return total

    def _conservative_inertia(self, k: Kinematics, a: Array) -> Array:
        """The same for added mass that conserves energy; k is the middle of a step of length k.h."""
        h = k.h
        if h is None:
            raise ValueError("effects.morison_inertia.added_mass: 'lagrangian' is a force over a step")
        length = k.line.length[:, None]
        before = k.v - 0.5 * h * a
        after = k.v + 0.5 * h * a
        middle = k.links / length
        turn = 0.5 * h * k.link_velocities / length
        first = middle - turn
        last = middle + turn
        total = jnp.zeros_like(a)
        can, cat = self._coefficients(k)
        for end in k.line.link_ends():
            mass = self._wet_mass(k, end)
            change = end.at(a)
            v0 = end.at(before)
            v1 = end.at(after)
            momentum = last * _scalar_product(last, v1) - first * _scalar_product(first, v0)
            total = total + end.collect(mass * (can * change + (cat - can) * momentum / h))
            turning = v0 * _scalar_product(middle, v1) + v1 * _scalar_product(middle, v0)
            force = 0.5 * mass * (cat - can) * turning
            total = total + k.model.geometry.gather(force / length)
        return total

    def kinetic(self, k: Kinematics) -> Array:
        """Kinetic energy of the added mass at a plain instant [J]."""
        sea = k.sea
        line = k.line
        elevation = sea.elevation(k.r, k.t)
        total = jnp.zeros((), k.r.dtype)
        can, cat = self._coefficients(k)
        for end in k.line.link_ends():
            wet = wet_share(k, end, k.tangents, elevation)
            mass = (end.share * (sea.density * line.volume) * wet)[:, None]
            v = end.at(k.v)
            along = split(v, k.links / line.length[:, None])[1]
            total = total + 0.5 * jnp.sum(mass * v * (can * v + (cat - can) * along))
        return total


def _per_link(value: Array) -> Array:
    """A number, or one value per link (n,) as a column that multiplies (n, 3)."""
    if jnp.ndim(value) == 0:
        return value
    return value[:, None]


def _scalar_product(a: Array, b: Array) -> Array:
    """Scalar products of vectors (n, 3), as a column (n, 1)."""
    return jnp.sum(a * b, axis=-1, keepdims=True)
