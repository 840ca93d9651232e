"""Rigid bodies of a scene: their mass, shape and attachments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dropper_jax.base.errors import Check
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection, Table, as_table, count, items, part, read_positions, short_text

#: Distance outside its shape at which a body's attachments may be without a warning, over the body's extent: shackles,
#: rounding.
OUTSIDE_SHARE = 0.05


@section
class CylinderSpec(DeclaredSection):
    """A cylinder of a body, from one end of its axis to the other; a stepped buoy has several, one after another."""

    start: np.ndarray = parameter("one end of the axis", unit="m", shape="vector", key="from")
    end: np.ndarray = parameter("the other end", unit="m", shape="vector", key="to")
    diameter: float = parameter("diameter", unit="m", above=0.0)
    slices: int = count("slices along the axis for water forces", default=8)
    cdn: float = parameter("drag coefficient across", unit="-", low=0.0, default=1.0)
    cdt: float = parameter("drag coefficient of each end", unit="-", low=0.0, default=0.0)
    can: float = parameter("added mass coefficient across", unit="-", low=0.0, default=1.0)
    cat: float = parameter("added mass coefficient of each end, of a half sphere", unit="-", low=0.0, default=0.0)
    ends: str = option("ends exposed to water", choices=("both", "from", "to", "none"), default="both")

    def checks(self) -> Iterator[Check]:
        yield (
            np.array_equal(self.start, self.end),
            f"to: {short_text(self.end)} is equal to `from`; allowed: a position other than `from`",
        )

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    def distance(self, position: np.ndarray) -> float:
        """Distance of a position (3,) from the cylinder's surface [m]; 0 inside."""
        along = (self.end - self.start) / self.length
        s = along @ (position - self.start)
        across = np.linalg.norm(position - self.start - s * along)
        return np.hypot(max(-s, s - self.length, 0.0), max(across - 0.5 * self.diameter, 0.0))


@section
class SphereSpec(DeclaredSection):
    """A sphere of a body."""

    centre: np.ndarray = parameter("centre", unit="m", shape="vector")
    diameter: float = parameter("diameter", unit="m", above=0.0)
    cd: float = parameter("drag coefficient", unit="-", low=0.0, default=0.5)
    ca: float = parameter("added mass coefficient", unit="-", low=0.0, default=0.5)

    def distance(self, position: np.ndarray) -> float:
        """Distance of a position (3,) from the sphere's surface [m]; 0 inside."""
        return max(float(np.linalg.norm(position - self.centre)) - 0.5 * self.diameter, 0.0)


@section
class BodySpec(DeclaredSection):
    """`[[body]]`: a rigid body (see `effects.rigid_bodies`); positions are in its own axes, from its reference point.

    Attitude is roll, pitch and yaw about x, y and z: `R = Rz(yaw) Ry(pitch) Rx(roll)` rotates its axes into the
    scene's.
    """

    name: str = option("name", type=str)
    position: np.ndarray = parameter("position of its reference point", unit="m", shape="vector")
    mass: float = parameter("mass", unit="kg", above=0.0)
    centre_of_mass: np.ndarray = parameter("centre of mass", unit="m", shape="vector")
    inertia: np.ndarray = parameter(
        "moments of inertia about the centre of mass: Ixx, Iyy, Izz, or these and Ixy, Ixz, Iyz",
        unit="kg m^2",
        shape="table",
    )
    attitude: np.ndarray = parameter("roll, pitch and yaw", unit="rad", shape="vector", default=(0.0, 0.0, 0.0))
    velocity: np.ndarray = parameter(
        "velocity of the centre of mass at the start", unit="m/s", shape="vector", default=(0.0, 0.0, 0.0)
    )
    angular_velocity: np.ndarray = parameter(
        "angular velocity at the start, in its axes", unit="rad/s", shape="vector", default=(0.0, 0.0, 0.0)
    )
    touches_bed: bool = option("whether its cylinders and spheres touch the seabed", type=bool, default=False)
    bed_friction: float = parameter("coefficient of its friction on the seabed", unit="-", low=0.0, default=0.0)
    pinned: bool = option("whether its reference point is fixed", type=bool, default=False)
    cylinders: tuple[CylinderSpec, ...] = part(items(CylinderSpec), default=())
    spheres: tuple[SphereSpec, ...] = part(items(SphereSpec), default=())
    attachments: dict[str, np.ndarray] = part(read_positions, default_factory=dict)

    def checks(self) -> Iterator[Check]:
        count = len(self.inertia)
        yield (
            count not in (3, 6),
            f"inertia: {short_text(self.inertia)} has {count} entries; allowed: 3 moments, or 3 and 3 products",
        )
        moments = np.linalg.eigvalsh(self.inertia_matrix)
        yield (
            moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9),
            f"inertia: principal moments {', '.join(f'{value:.4g}' for value in moments)} kg m^2 are not those "
            "of a body; allowed: > 0, none above the sum of the other two",
        )
        yield (
            self.bed_friction > 0.0 and not self.touches_bed,
            f"bed_friction: {self.bed_friction:g} of a body that does not touch the seabed. Use 0, or "
            "`touches_bed = true`",
        )
        yield (
            self.pinned and bool(np.any(self.velocity)),
            f"velocity: {self.velocity.tolist()} of a pinned body, which only rotates. Use `angular_velocity` alone",
        )

    def outside(self) -> dict[str, float]:
        """Distance [m] by which attachments are outside the shapes, by name, for those beyond the reach of shackles."""
        found = {}
        for name, position in self.attachments.items():
            distance = min((shape.distance(position) for shape in self.shapes), default=0.0)
            if distance > OUTSIDE_SHARE * self.extent:
                found[name] = distance
        return found

    @property
    def inertia_matrix(self) -> np.ndarray:
        """Inertia about the centre of mass (3, 3) [kg m^2]."""
        xx, yy, zz, xy, xz, yz = [*self.inertia, 0.0, 0.0, 0.0][:6]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def shapes(self) -> tuple[CylinderSpec | SphereSpec, ...]:
        return (*self.cylinders, *self.spheres)

    @property
    def extent(self) -> float:
        """Longest side of the box around its shapes [m]."""
        if not self.shapes:
            return 0.0
        positions = []
        for cylinder in self.cylinders:
            positions += [cylinder.start, cylinder.end]
        for sphere in self.spheres:
            positions += [sphere.centre - 0.5 * sphere.diameter, sphere.centre + 0.5 * sphere.diameter]
        return max(*np.ptp(positions, axis=0), *(shape.diameter for shape in self.shapes))

    @property
    def rotation(self) -> np.ndarray:
        """Its axes in the scene's (3, 3)."""
        return rotation(self.attitude)

    def world(self, position: np.ndarray) -> np.ndarray:
        """Positions (..., 3) in its axes, converted to the scene's axes at the start."""
        return self.position + position @ self.rotation.T

    def table(self) -> Table:
        zero = ("attitude", "velocity", "angular_velocity", "touches_bed", "bed_friction", "pinned")
        return {key: value for key, value in as_table(self).items() if key not in zero or np.any(value)}


def rotation(attitude: Sequence[float] | np.ndarray) -> np.ndarray:
    """`Rz(yaw) Ry(pitch) Rx(roll)` (3, 3)."""
    sx, sy, sz = np.sin(attitude)
    cx, cy, cz = np.cos(attitude)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def attitude(turned: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw (..., 3) [rad] of rotations (..., 3, 3)."""
    roll = np.arctan2(turned[..., 2, 1], turned[..., 2, 2])
    pitch = np.arcsin(np.clip(-turned[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(turned[..., 1, 0], turned[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)
