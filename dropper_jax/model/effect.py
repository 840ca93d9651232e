"""What an effect is: a frozen dataclass that fills some of the slots of `model.slots` by defining their methods.

All methods are pure functions of `k`, a `dropper_jax.model.kinematics.Kinematics`: positions, velocities, link vectors
and rates, computed on demand. A law with its own unknowns (dry friction) is a `Law`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.read import Values
from dropper_jax.model.kinematics import Kinematics, ModelView
from dropper_jax.model.line import Line
from dropper_jax.model.slots import PAIRS
from dropper_jax.scene import SceneData


class Effect:
    """Base of all effects; subclasses are `component` dataclasses with a `name`, the key in `[effects.NAME]`."""

    name: ClassVar[str]
    #: Whether the force is independent of positions and velocities, so that it adds nothing to a Jacobian.
    constant: ClassVar[bool] = False
    #: Whether its `displace` takes the sea as a second argument.
    needs_sea: ClassVar[bool] = False
    #: Whether it reads `k.water`; the scene must then have a sea, whose kinematics are computed once per step.
    needs_water: ClassVar[bool] = False
    #: Whether it counts nodes, links or joints of one line, and so supports scenes of one line only.
    single_line: ClassVar[bool] = False
    #: Names of effects that it requires.
    needs: ClassVar[tuple[str, ...]] = ()
    #: Whether it acts only on corners of rigid bodies (see `HolonomicConstraint`).
    bodily: ClassVar[bool] = False
    #: Whether a part of its potential is lost when a link breaks (see `failure`).
    breaks_with_links: ClassVar[bool] = False

    @property
    def reach(self) -> int:
        """Reach of the force in nodes: 0 own node, 1 neighbouring nodes, 2 next neighbours. Solvers rely on it."""
        return 0

    @property
    def needs_material(self) -> bool:
        """Whether it reads `k.water.material`, the material acceleration of the water."""
        return False

    @property
    def needs_current(self) -> bool:
        """Whether it reads `k.water.current`, the current alone."""
        return False

    @property
    def kinks(self) -> Array | None:
        """Times (k,) [s] at which the velocity or acceleration of a prescribed motion jumps; None: never."""
        return None

    @property
    def corners(self) -> Array | None:
        """Times (k,) [s] at which the effect is not smooth in time, for schemes that end steps there; None: never."""
        return self.kinks

    def __init_subclass__(cls) -> None:
        for given, needed in PAIRS:
            if hasattr(cls, given) and not hasattr(cls, needed):
                raise TypeError(f"{cls.__name__}: defines `{given}`, which also needs `{needed}`")

    def moves(self, name: str) -> bool:
        """Whether `displace` moves the fixed point of that name, which the option `point` gives."""
        return name == getattr(self, "point", None)

    def motion_of(self, name: str) -> Effect:
        """The effect whose `displace` moves the fixed point of that name: of a group of motions, the one for it."""
        return self

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        """Raise `SceneError` for combinations of values that single-field ranges cannot express."""

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        """Build the effect from validated scene values (None if omitted)."""
        return cls(**values)


class HeldMotion(Effect):
    """An effect that moves fixed points together: it has the options `point` and `also`, and `displace`."""

    @property
    def point(self) -> str:
        """Name of the point that moves."""
        raise NotImplementedError

    @property
    def also(self) -> tuple[str, ...]:
        """Further points that move with it."""
        return ()

    def moves(self, name: str) -> bool:
        """Whether a fixed point of that name moves: `point` and those that move with it."""
        return name == self.point or name in self.also

    @classmethod
    def check_points(cls, values: Values, scene: SceneData) -> None:
        """Reject points that are not fixed."""
        scene.check_fixed(values["point"], f"effects.{cls.name}.point")
        for i, name in enumerate(values["also"]):
            scene.check_fixed(name, f"effects.{cls.name}.also.{i}")


class Law(Effect, ABC):
    """An effect with its own unknowns, `components` per joint, solved together with the step.

    Joint j is at node j of a single line, j = 0..n (the last one only if that end is fixed). The unknown z (joints, c)
    enters the motion through `law_force` and is determined by `law_residual` = 0. Both reach one neighbour at most.
    """

    #: Whether each row of z acts on one free node and depends on that node only; rows are then the free nodes.
    node_local: ClassVar[bool] = False

    @property
    def of_state(self) -> bool:
        """Whether z follows from positions and velocities alone, by `at`; explicit schemes support such laws."""
        return False

    @property
    @abstractmethod
    def components(self) -> int:
        """Number of unknowns per joint."""

    def rows(self, model: ModelView) -> int:
        """Number of rows of z."""
        if self.node_local:
            return model.free_nodes
        return model.geometry.links + model.geometry.ends - 1

    @abstractmethod
    def law_force(self, k: Kinematics, z: Array) -> Array:
        """Nodal force of the unknown, (nodes, 3) [N]."""

    @abstractmethod
    def law_residual(self, k: Kinematics, z: Array, h: Array, easing: Array | None = None) -> Array:
        """Rows that determine z, same shape as z; `k` is the middle of the step.

        With `easing` (scalar, 1 to 0) those of a smoothed law, which equals the law itself at 0.
        """

    def at(self, k: Kinematics) -> Array:
        """For a law of the state: z at one instant."""
        raise NotImplementedError

    @abstractmethod
    def admissible(self, z: Array) -> Array:
        """The nearest z that the law allows."""

    def rates(self, k: Kinematics) -> Array:
        """Rates (joints, c) conjugate to z: the power of `law_force` is `sum(z * rates)`."""
        raise NotImplementedError

    def sliding_power(self, k: Kinematics) -> Array:
        """Power [W] that the law takes from a motion in which no joint sticks."""
        raise NotImplementedError

    def holding(self, k: Kinematics, z: Array, h: Array) -> Array:
        """Which joints (joints, 1) were stuck at the middle of the step."""
        raise NotImplementedError

    def stop(self, k: Kinematics, v1: Array, z: Array, h: Array) -> Array:
        """For a node-local law: end velocities (nodes, 3) [m/s], zero for nodes that were stuck at the middle."""
        raise NotImplementedError

    @abstractmethod
    def law_scale(self, line: Line, h: Array) -> Array:
        """Scale of a row, scalar: the residual tolerance is relative to it."""


@dataclass(frozen=True)
class HolonomicConstraint(Effect, ABC):
    """Equality constraints between nodes, at most quadratic in their positions, with one multiplier each.

    The gaps vanish at the end of every step; multipliers act along the gaps' gradient at its middle. For quadratic gaps
    that does exactly no work (Gonzalez 1999). A model has at most one such constraint. The network's matrix supports
    those of rigid bodies: corners with six constant distances, and nodes attached to a body.
    """

    bodily: ClassVar[bool] = True
    #: Masses of the bodies (bodies,) [kg].
    mass: Array

    @property
    def pinned(self) -> tuple[int, ...]:
        """Numbers of the bodies whose reference point is pinned: their three gaps come last."""
        return ()

    @abstractmethod
    def pose(self, model: ModelView, r: Array) -> tuple[Array, Array]:
        """Reference points (bodies, 3) [m] and axes (bodies, 3, 3) of the bodies at positions r (free nodes, 3)."""

    @abstractmethod
    def references(self, corners: Array) -> Array:
        """Reference points (bodies, 3) [m] of bodies whose corners are at (bodies, 4, 3)."""

    @abstractmethod
    def rows(self, model: ModelView) -> int:
        """Number of gaps."""

    @abstractmethod
    def gap(self, model: ModelView, r: Array) -> Array:
        """The gaps (rows,) [m] at positions r (free nodes, 3)."""

    @abstractmethod
    def gap_size(self, model: ModelView) -> Array:
        """Scales of the gaps (rows,) [m]."""

    @abstractmethod
    def force_size(self, model: ModelView) -> Array:
        """Scales of the multipliers (rows,) [N]."""

    @abstractmethod
    def body_nodes(self, model: ModelView) -> np.ndarray:
        """Free nodes at the corners of each body (bodies, 4)."""

    @abstractmethod
    def seats(self, model: ModelView) -> np.ndarray:
        """Free nodes attached to a body (seats,)."""

    @abstractmethod
    def seat_shares(self) -> Array:
        """Position of each attached point as weights of all corners (seats, 4 bodies)."""

    @abstractmethod
    def initial_velocities(self, model: ModelView, r: Array) -> Array:
        """Initial velocities (free nodes, 3) [m/s] of the bodies, at positions r."""

    def constraint_force(self, model: ModelView, r: Array, z: Array) -> Array:
        """Force (nodes, 3) [N] of multipliers z (rows,) at positions r."""
        return -jax.vjp(lambda position: self.gap(model, position), r)[1](z)[0]


def per_node(value: Array, nodes: int) -> Array:
    """A number or one value per node (n,) as a column that multiplies (nodes, 3); the entry of a fixed end is
    dropped."""
    if jnp.ndim(value) == 0:
        return value
    return value[:nodes, None]
