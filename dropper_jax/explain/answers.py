"""What a mooring at rest does and why: numbers per line, each next to a closed form or a second equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.explain.catenary import Hanging, Shape, hanging_length, offset_until_uplift, solve
from dropper_jax.load.checks_water import bed_height
from dropper_jax.run.build import build_model, equilibrium
from dropper_jax.run.line_weights import end_angles, end_forces, wet_weights
from dropper_jax.run.model_slopes import shift_model
from dropper_jax.scene import whole_lines
from dropper_jax.statics.rigid_group import stiffness_of_group
from dropper_jax.statics.static_pose import release_loads, settle

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.model import State
    from dropper_jax.scene.data import WholeLine
    from dropper_jax.scene.line import LineSpec
    from dropper_jax.statics.search import Equilibrium

#: Share of the diameter that is left after the wear that is asked about, and of area, mass and stiffness.
WORN = 0.9
#: Distance from the bed [m], per metre of a link, within which a node lies on it.
ON_BED = 0.05


@dataclass(frozen=True)
class LineFacts:
    """A line at rest.

    Attributes:
        name: of the line.
        length_m, apart_m: its unstretched length, and the distance of its ends.
        on_bed_m: its length on the seabed.
        uplift_deg: angle of its lower end link above the horizontal.
        lower_n, upper_n: force on its lower and its upper end point.
        closed_lower_n, closed_upper_n: the same by the elastic catenary; None where that does not apply.
        reserve_m: distance by which the upper end may move away before the lower end is lifted off the bed.
        excess_m: length beyond that from which the line hangs straight down from its upper end; negative below it.
        axial_n_per_m: EA over the length.
        horizontal_n_per_m: stiffness of the upper end along the line's plane, by the closed form.
        axial_period_s: period of its first axial mode, both ends held.
        damping_ratio, link_damping_ratio: of that mode and of the stiffest link, by the internal damping.
    """

    name: str
    length_m: float
    apart_m: float
    on_bed_m: float
    uplift_deg: float
    lower_n: float
    upper_n: float
    closed_lower_n: float | None
    closed_upper_n: float | None
    reserve_m: float | None
    excess_m: float | None
    axial_n_per_m: float
    horizontal_n_per_m: float | None
    axial_period_s: float
    damping_ratio: float
    link_damping_ratio: float

    @property
    def verdict(self) -> str:
        """Whether the line is long enough, in words."""
        if self.on_bed_m > 0.0 and self.excess_m is not None and self.excess_m > 0.0:
            return f"too long by {self.excess_m:.3g} m: hangs straight down, holds nothing sideways"
        if self.reserve_m is not None and self.reserve_m > 0.0:
            return f"long enough: its anchor lifts after {self.reserve_m:.3g} m of offset"
        if self.reserve_m is not None:
            return f"lifts its anchor by {self.uplift_deg:.3g} degrees"
        if self.on_bed_m > 0.0 and self.on_bed_m < self.length_m:
            return "long enough: part of it rests on the bed"
        if self.length_m > self.apart_m:
            return "hangs between its ends"
        return "taut"


@dataclass(frozen=True)
class Wear:
    """Largest tension of a line when all lines have lost a tenth of their diameter.

    Attributes:
        tension_n: now.
        by_derivative_n: worn, from the exact derivative of the equilibrium; by_equilibrium_n: from another one.
        use, worn_use: tension over the breaking load, now and worn; None without one.
    """

    name: str
    tension_n: float
    by_derivative_n: float
    by_equilibrium_n: float | None
    use: float | None
    worn_use: float | None


@dataclass(frozen=True)
class Explained:
    """All answers on a scene.

    Attributes:
        lines, wear: by line.
        held: upper fixed points, which move together as a floater does.
        stiffness: of these about the origin (6, 6); None where there are none.
        closed_stiffness: horizontal stiffness along x and y by the closed forms of the lines; None if one has none.
        ignored: what the source file has and the scene does not.
    """

    lines: tuple[LineFacts, ...]
    wear: tuple[Wear, ...]
    held: tuple[str, ...]
    stiffness: np.ndarray | None
    closed_stiffness: tuple[float, float] | None
    ignored: tuple[str, ...]


def explain(scene: Scene, pose: Equilibrium) -> Explained:
    """The answers on a scene at rest.

    Args:
        pose: `equilibrium(scene)`, with status ok.

    Raises:
        SceneError: rigid links, whose tensions do not follow from lengths.
    """
    refuse_rigid(scene)
    state = pose.state
    positions = pose.positions
    closed = {}
    facts = []
    weights = wet_weights(scene)
    forces = end_forces(scene, positions[None], pose.tension[None])
    uplift = end_angles(positions[None], whole_lines(scene))
    for line in whole_lines(scene):
        hung = _HungLine(scene, line, positions, weights[line.links].sum())
        closed[line.name] = hung.closed
        facts.append(hung.facts(forces[line.name][0], uplift[line.name][0]))
    held = _held_above(scene)
    matrix = None
    if held:
        matrix = stiffness_of_group(build_model(scene), state, held, (0.0, 0.0, 0.0)).matrix
    sums = _closed_stiffness(scene, positions, closed, held)
    return Explained(tuple(facts), tuple(_wear(scene, state)), held, matrix, sums, tuple(scene.notes))


def refuse_rigid(scene: Scene) -> None:
    """Refuse a scene with rigid links, whose tensions do not follow from lengths."""
    for line in scene.lines:
        _stiffness_of(line)


def _stiffness_of(line: LineSpec) -> np.ndarray:
    """EA (n,) [N] of a line that stretches."""
    if line.EA is None:
        raise SceneError(
            f"line {line.name}: rigid links have no stiffness; allowed for explain: elastic, rope, tabulated"
        )
    return line.EA


class _HungLine:
    """A line of a weight [N] in water in its pose: its ends by height, and its closed form where that applies."""

    def __init__(self, scene: Scene, line: WholeLine, positions: np.ndarray, weight: float) -> None:
        self.line = line
        nodes = positions[line.nodes]
        self.turned = bool(nodes[0, 2] > nodes[-1, 2])
        self.low = nodes[-1 if self.turned else 0]
        self.high = nodes[0 if self.turned else -1]
        self.length = line.spec.length.sum()
        self.weight = weight / self.length
        self.on_bed = _length_on_bed(scene, line, nodes)
        self.hanging = self._hanging(scene)
        self.closed = None if self.hanging is None else solve(self.hanging)

    def _hanging(self, scene: Scene) -> Hanging | None:
        """The line as a uniform one, if it is: no current, no point between its ends, all of it under water."""
        spec = self.line.spec
        each = [spec.length, spec.mass, _stiffness_of(spec), spec.diameter]
        uniform = all(values is not None and np.ptp(values) <= 1e-6 * np.max(values) for values in each)
        still = scene.sea is not None and scene.sea.current is None
        if not uniform or not still or len(self.line.stops) != 2:
            return None
        if self.weight == 0.0 or spec.axial_law == "tabulated":
            return None
        if max(self.low[2], self.high[2]) > 0.0 or "bending" in scene.effects:
            return None
        rests = self.weight > 0.0 and self.on_bed > 0.0
        span = np.hypot(*(self.high - self.low)[:2])
        rise = self.high[2] - self.low[2]
        return Hanging(span, rise, self.length, abs(self.weight), _stiffness_of(spec)[0], rests)

    @property
    def closed_ends(self) -> tuple[float | None, float | None]:
        """Tension [N] of the lower and the upper end by the closed form; a line that floats is one upside down."""
        if self.closed is None:
            return None, None
        ends = self.closed.lower, self.closed.upper
        if self.weight > 0.0:
            return ends
        return ends[::-1]

    def facts(self, forces: np.ndarray, angles: np.ndarray) -> LineFacts:
        """The facts of the line, with the forces (2,) [N] on its points and the angles (2,) [deg] of its end links."""
        spec = self.line.spec
        lower, upper = forces[::-1] if self.turned else forces
        closed_lower, closed_upper = self.closed_ends
        per_metre = spec.mass.sum() / self.length
        EA = _stiffness_of(spec)
        flexibility = np.sum(spec.length / EA)
        speed = self.length / np.sqrt(flexibility * spec.mass.sum())
        damping = np.zeros(1) if spec.axial_damping is None else spec.axial_damping
        rate = np.pi * speed / self.length
        excess = None
        reserve = None
        stiffness = None
        if self.hanging is not None:
            excess = self.length - self.hanging.span - hanging_length(self.hanging)
            reserve = offset_until_uplift(self.hanging) if self.hanging.on_bed else None
        if self.closed is not None and self.closed.stiffness is not None:
            stiffness = self.closed.stiffness[0, 0]
        fastest = 2.0 / np.min(spec.length) * np.sqrt(np.max(EA) / per_metre)
        return LineFacts(
            name=self.line.name,
            length_m=self.length,
            apart_m=np.linalg.norm(self.high - self.low),
            on_bed_m=self.on_bed,
            uplift_deg=(angles[-1] if self.turned else angles[0]),
            lower_n=lower,
            upper_n=upper,
            closed_lower_n=closed_lower,
            closed_upper_n=closed_upper,
            reserve_m=reserve,
            excess_m=excess,
            axial_n_per_m=1.0 / flexibility,
            horizontal_n_per_m=stiffness,
            axial_period_s=(2.0 * np.pi / rate),
            damping_ratio=(0.5 * rate * np.mean(damping) * flexibility / self.length),
            link_damping_ratio=(0.5 * fastest * np.max(damping / np.max(EA))),
        )


def _length_on_bed(scene: Scene, line: WholeLine, nodes: np.ndarray) -> float:
    """Unstretched length [m] of the links that lie on the seabed with both nodes."""
    if "seabed" not in scene.effects:
        return 0.0
    length = line.spec.length
    lies = nodes[:, 2] - bed_height(scene, nodes) < ON_BED * np.mean(length)
    return np.sum(length[lies[1:] & lies[:-1]])


def _held_above(scene: Scene) -> tuple[str, ...]:
    """Fixed points at which all lines end with their upper end."""
    height = {point.name: point.position[2] for point in scene.points}
    lower = set()
    for line in whole_lines(scene):
        first, *_, last = line.stops.values()
        lower.add(first if height[first] <= height[last] else last)
    ends = {name for line in whole_lines(scene) for name in line.stops.values()}
    return tuple(p.name for p in scene.points if not p.is_free and p.name in ends and p.name not in lower)


def _closed_stiffness(
    scene: Scene, positions: np.ndarray, closed: dict[str, Shape | None], held: tuple[str, ...]
) -> tuple[float, float] | None:
    """Sum of the horizontal stiffnesses [N/m] along x and y of the lines at these points, all from a fixed anchor."""
    if not held:
        return None
    fixed = {point.name for point in scene.points if not point.is_free}
    total = np.zeros(2)
    for line in whole_lines(scene):
        ends = list(line.stops.values())
        if not set(ends) & set(held):
            continue
        shape = closed[line.name]
        if shape is None or shape.stiffness is None or not set(ends) <= fixed:
            return None
        across = (positions[line.nodes[-1]] - positions[line.nodes[0]])[:2]
        span = np.hypot(*across)
        if span == 0.0:
            return None
        along = (across / span) ** 2
        # a displacement across turns the line
        total += along * shape.stiffness[0, 0] + (1.0 - along) * shape.horizontal / span
    return total[0], total[1]


def _wear(scene: Scene, state: State) -> list[Wear]:
    """Tensions when all lines are worn: area, mass, stiffness, breaking load fall with the square of the diameter."""
    worn = scene.with_values(_worn_values(scene))
    tension = np.asarray(state.tension)
    predicted = tension + _along(scene, worn, state)
    again = equilibrium(worn)
    exact = again.tension if again.status == "ok" else None

    def largest(values: np.ndarray | None, line: WholeLine, load: np.ndarray | float | None = 1.0) -> float | None:
        return None if values is None or load is None else np.max(values[line.links] / load)

    found = []
    for line in whole_lines(scene):
        load = line.spec.breaking_load
        loads = [largest(values, line) for values in (tension, predicted, exact)]
        worn_load = None if load is None else load * WORN**2
        found.append(Wear(line.name, *loads, largest(tension, line, load), largest(exact, line, worn_load)))
    return found


def _worn_values(scene: Scene) -> Table:
    values: Table = {}
    for i, line in enumerate(scene.lines):
        values[f"line.{i}.mass"] = (WORN**2 * line.mass).tolist()
        values[f"line.{i}.axial.EA"] = (WORN**2 * _stiffness_of(line)).tolist()
        for key in ("diameter", "outer_diameter"):
            size = getattr(line, key)
            if size is not None:
                values[f"line.{i}.{key}"] = (WORN * size).tolist()
    return values


def _along(scene: Scene, worn: Scene, state: State) -> np.ndarray:
    """Change (n,) [N] of the tensions from the scene to the worn one, by the derivative at the scene's equilibrium."""
    model = build_model(scene)
    loads = release_loads(model, scene.start)
    pairs = zip(jax.tree.leaves(model), jax.tree.leaves(build_model(worn)), strict=True)
    change = {}
    for i, (a, b) in enumerate(pairs):
        if np.any(np.asarray(a) != np.asarray(b)):
            change[i] = np.asarray(b) - np.asarray(a)
    rows = [row[None] for row in change.values()]

    def tension(shift: jax.Array) -> jax.Array:
        return settle(shift_model(model, list(change), rows, shift), state, loads, there=True).tension

    return np.asarray(jax.jvp(tension, (jnp.zeros(1),), (jnp.ones(1),))[1])
