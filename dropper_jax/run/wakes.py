"""Wakes of lines in the current: the fraction of the current at each link, constant during the run.

The wakes are those of the equilibrium in the undisturbed current. Each link is an element of `sea.wakes` with its drag
coefficient `cdn` and its frontal area. The current of the wake model is uniform, with the value at the mean height of
the lines; the resulting fractions multiply the profile. Waves are not reduced.

Wakes of lines in a current: Gaussian, each with the momentum of its drag, added so that momentum is conserved.

Element i of frontal area A_i and drag coefficient C_i at (x_i, y_i, z_i), x along the current, has the inflow u_i and
the drag `T_i/rho = 1/2 C_i A_i u_i^2`. Its wake is `u_i - a g(y) h(z)`, whose width grows as that of a plane
turbulent wake (Schlichting, Boundary-Layer Theory: half-width 0.25 sqrt(C D x), thus sigma^2 = 0.0451 C D x) and with
the turbulence of the water, `sigma = I x`; surface and seabed reflect it. The amplitude follows from momentum,

    integral (u_i - a g h) a g h dA = T_i/rho,

and wakes are added by Zong and Porte-Agel (2020): `U_s = sum_i (c_i/U_c) a_i g_i h_i` with the convection velocities
`c_i = u_i - a_i int(g h)^2/int(g h)` of each and `U_c = U - int U_s^2/int U_s` of all, found together (here a quadratic
equation). Thus `rho int (U - U_s) U_s dA = sum T_i` at every x. Drag and deficit are solved together, going downstream.

The model omits the flow around a dense farm due to pressure, and the turbulence of wakes. If the drag of a dense farm
exceeds the momentum of the water in the wake (at a deficit of about half), the deficit is limited and the wake contains
less momentum than the drag. `Wakes.balance` is their ratio.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.effects.buoyancy import drag_diameter
from dropper_jax.effects.cylinder import steady_drag
from dropper_jax.effects.morison_drag import relative_roughness
from dropper_jax.load.scene import Scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.scene import LineSlice, line_slices

#: Growth of sigma^2 over C D x: (0.25/1.1774)^2.
WAKE_GROWTH = (0.25 / 1.1774) ** 2
#: Sigma at the element over C D: the deficit there is about half of the flow.
START = 0.5
#: Distance in diameters behind an element at which its wake starts.
BEHIND = 2.0


@dataclasses.dataclass(frozen=True)
class Elements:
    """Elements of lines (n,): positions [m], x along the current, extents across it [m], diameter [m], drag
    coefficient."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    wide: np.ndarray
    high: np.ndarray
    diameter: np.ndarray
    drag: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """Frontal area (n,) [m^2]."""
        return self.diameter * np.hypot(self.wide, self.high)


@dataclasses.dataclass(frozen=True)
class Wakes:
    """Solved wakes: the current [m/s] without them, inflow of each element (n,) [m/s], its drag over rho (n,)."""

    elements: Elements
    speed: float
    depth: float
    turbulence: float
    met: np.ndarray
    drag: np.ndarray

    @property
    def balance(self) -> float:
        """Momentum deficit in the wake behind all elements over their total drag: 1, or less in a farm that is too
        dense."""
        total = float(np.sum(self.drag))
        end = float(np.max(self.elements.x)) + 10.0 * float(np.max(self.elements.diameter))
        return self.plane(end).momentum / total if total > 0.0 else 1.0

    def plane(self, x: float) -> Plane:
        """The wakes at x [m] of all elements upstream of it."""
        e = self.elements
        first = e.x < x - BEHIND * e.diameter
        away = x - e.x[first]
        size = (e.drag * e.diameter)[first]
        grown = (START * size) ** 2 + WAKE_GROWTH * size * away + (self.turbulence * away) ** 2
        wide = np.sqrt(grown + e.wide[first] ** 2 / (2 * np.pi))
        high = np.sqrt(grown + e.high[first] ** 2 / (2 * np.pi))
        y, z, u, thrust = e.y[first], e.z[first], self.met[first], self.drag[first]
        # number of heights over the depth for the integration of wakes
        nodes, weight = np.polynomial.legendre.leggauss(48)
        upright = _upright(0.5 * self.depth * (nodes - 1.0), z, high, self.depth)
        weight = 0.5 * self.depth * weight
        one = np.sqrt(2 * np.pi) * wide * (upright @ weight)
        spread = wide[:, None] ** 2 + wide**2
        across = np.sqrt(2 * np.pi) * wide[:, None] * wide / np.sqrt(spread)
        both = across * np.exp(-0.5 * (y[:, None] - y) ** 2 / spread) * ((upright * weight) @ upright.T)
        two = np.diag(both)
        # a wake cannot take more than a quarter of int(g h)^2/int((g h)^2) u^2
        root = np.sqrt(np.clip((u * one) ** 2 - 4.0 * two * thrust, 0.0, None))
        amplitude = (u * one - root) / (2.0 * two)
        carried = u - amplitude * two / one
        # with U_s = b sum_i c_i a_i g_i h_i, b = 1/U_c, momentum is a quadratic equation of b
        share = amplitude * carried
        wanted, square = float(share @ one), float(share @ both @ share)
        left = (self.speed * wanted) ** 2 - 4.0 * square * wanted
        share = share * (self.speed * wanted - np.sqrt(max(left, 0.0))) / (2.0 * square) if square > 0.0 else share
        momentum = self.speed * float(share @ one) - float(share @ both @ share)
        return Plane(y, z, wide, high, share, self.depth, momentum)

    def velocity(self, x: np.ndarray, y: np.ndarray, z: float) -> np.ndarray:
        """Velocity (nx, ny) [m/s] over a grid at a height [m]."""
        return np.array([self.speed - self.plane(one).deficit(y, np.array([z]))[:, 0] for one in x])


@dataclasses.dataclass(frozen=True)
class Plane:
    """Wakes at one x: centres, widths, profiles over `heights`, amplitudes with their weights c_i/U_c."""

    y: np.ndarray
    z: np.ndarray
    wide: np.ndarray
    high: np.ndarray
    amplitude: np.ndarray
    depth: float
    momentum: float

    def deficit(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """U_s (ny, nz) [m/s]."""
        across = np.exp(-0.5 * ((y[:, None] - self.y) / self.wide) ** 2)
        return across * self.amplitude @ _upright(z, self.z, self.high, self.depth)


def solve_wakes(elements: Elements, speed: float, depth: float, turbulence: float = 0.05) -> Wakes:
    """Wakes of elements in a current [m/s] over a depth [m], from upstream to downstream.

    Args:
        turbulence: of the water without the farm, rms over mean.
    """
    count = len(elements.x)
    wakes = Wakes(elements, float(speed), float(depth), turbulence, np.full(count, float(speed)), np.zeros(count))
    at, plane = -np.inf, wakes.plane(-np.inf)
    for i in np.argsort(elements.x, kind="stable"):
        if elements.x[i] > at + 0.5 * BEHIND * elements.diameter[i]:  # elements next to each other share a plane
            at = elements.x[i]
            plane = wakes.plane(at)
        # at its centre, where Gaussians of this width equal a box of this extent
        lost = plane.deficit(elements.y[i : i + 1], elements.z[i : i + 1])
        wakes.met[i] = max(wakes.speed - float(lost[0, 0]), 0.0)
        wakes.drag[i] = 0.5 * elements.drag[i] * elements.area[i] * wakes.met[i] ** 2
    return wakes


def _upright(z: np.ndarray, centre: np.ndarray, high: np.ndarray, depth: float) -> np.ndarray:
    """h_i (n, nz): Gaussians over z, mirrored at the surface and at the seabed."""
    found = np.zeros((len(centre), len(z)))
    for mirror in (centre, -centre, -2.0 * depth - centre):
        found += np.exp(-0.5 * ((z - mirror[:, None]) / high[:, None]) ** 2)
    return found


@dataclasses.dataclass(frozen=True)
class SceneWakes:
    """Solved wakes, fraction of the current per link (n,), the lines, direction of the current [rad], positions (n,
    3)."""

    wakes: Wakes
    share: np.ndarray
    lines: tuple[LineSlice, ...]
    direction: float
    positions: np.ndarray


def has_wakes(scene: Scene) -> bool:
    return scene.effects.get("morison_drag", {}).get("wakes", "none") != "none"


def with_wakes(scene: Scene) -> Scene:
    """The scene with the current fractions of its wakes as `shelter`; a scene without wakes is unchanged."""
    if not has_wakes(scene):
        return scene
    drag = {**scene.effects["morison_drag"], "shelter": scene_wakes(scene).share, "wakes": "none", "turbulence": None}
    return dataclasses.replace(scene, effects={**scene.effects, "morison_drag": drag})


def scene_wakes(scene: Scene) -> SceneWakes:
    """The wakes of a scene's links.

    Raises:
        SceneError: no drag, no current, a zero current, or too many links.
    """
    most = 3000  # maximum number of links with wakes: the cost grows with its square, plane by plane
    drag = scene.effects.get("morison_drag")
    if drag is None or scene.sea is None or scene.sea.current is None:
        raise SceneError(f"effects.morison_drag.wakes: scene {scene.name!r} lacks morison_drag or [sea.current]")
    lines = line_slices(scene)
    if sum(line.links for line in scene.lines) > most:
        raise SceneError(f"effects.morison_drag.wakes: more than {most} links; allowed: at most {most}")
    bare = dataclasses.replace(scene, effects={**scene.effects, "morison_drag": {**drag, "wakes": "none"}})
    model = bare_model(bare, "float64")
    nodes = static_pose(bare, model).positions
    first = np.concatenate([nodes[line.nodes][:-1] for line in lines])
    last = np.concatenate([nodes[line.nodes][1:] for line in lines])
    middle, along = 0.5 * (first + last), last - first
    weight = np.linalg.norm(along, axis=1) * drag_diameter(scene.line, scene)
    height = float(np.sum(weight * middle[:, 2]) / np.sum(weight))
    stream = np.asarray(model.sea.current.profile(jnp.asarray([height]), model.sea.depth))[0, :2]
    speed = float(np.hypot(*stream))
    if speed < 1e-6:
        raise SceneError(
            "effects.morison_drag.wakes: the current is zero at the height of the lines; allowed: above 0 m/s"
        )
    course = stream / speed
    side = np.array([-course[1], course[0]])
    elements = Elements(
        x=middle[:, :2] @ course,
        y=middle[:, :2] @ side,
        z=np.clip(middle[:, 2], -scene.sea.depth, 0.0),
        wide=np.abs(along[:, :2] @ side),
        high=np.abs(along[:, 2]),
        diameter=drag_diameter(scene.line, scene) * np.ones(len(middle)),
        drag=_coefficient(scene) * np.ones(len(middle)),
    )
    # default turbulence intensity of the current (assumed)
    turbulence = 0.05 if drag["turbulence"] is None else float(drag["turbulence"])
    wakes = solve_wakes(elements, speed, scene.sea.depth, turbulence)
    return SceneWakes(wakes, wakes.met / speed, tuple(lines), float(np.arctan2(stream[1], stream[0])), middle)


def _coefficient(scene: Scene) -> np.ndarray:
    drag = scene.effects["morison_drag"]
    return steady_drag(relative_roughness(scene)) if drag["cdn"] is None else np.asarray(drag["cdn"], float)


def wake_facts(found: SceneWakes) -> dict[str, Any]:
    """Fractions of the current by line, total drag over that without wakes, and the momentum balance."""
    e, wakes = found.wakes.elements, found.wakes
    alone = 0.5 * np.sum(e.drag * e.area) * wakes.speed**2
    return {
        "current_m_per_s": wakes.speed,
        "turbulence": wakes.turbulence,
        "lines": [
            {"line": line.name, "share": {"min": float(s.min()), "mean": float(s.mean()), "max": float(s.max())}}
            for line in found.lines
            for s in [found.share[line.links]]
        ],
        "drag_over_unsheltered": float(np.sum(wakes.drag) / alone) if alone > 0.0 else 1.0,
        "balance": wakes.balance,
    }
