"""What a mooring at rest does and why: numbers per line, each next to a closed form or a second equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial.force_table import tables_of
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
WORN_DIAMETER = 0.9
#: Distance from the bed [m], per metre of a link, within which a node rests on it.
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
        if self.on_bed_m == self.length_m:
            return "rests on the bed"
        if self.on_bed_m > 0.0 and self.excess_m is not None and self.excess_m > 0.0:
            return f"too long by {self.excess_m:.3g} m: hangs straight down, holds nothing sideways"
        if self.reserve_m is not None and self.reserve_m > 0.0:
            return f"long enough: its anchor lifts after {self.reserve_m:.3g} m of offset"
        if self.reserve_m is not None:
            return f"lifts its anchor by {self.uplift_deg:.3g} degrees"
        if self.on_bed_m > 0.0:
            return "long enough: part of it rests on the bed"
        if self.length_m > self.apart_m:
            return "hangs between its ends"
        return "taut"


@dataclass(frozen=True)
class Wear:
    """Maximum tension of a line when all lines have lost a tenth of their diameter.

    Attributes:
        tension_n: now.
        by_derivative_n: worn, from the exact derivative of the equilibrium.
        by_equilibrium_n: worn, from another equilibrium; None if none is found.
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
        stiffness: of these about the origin (6, 6); None without any.
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
    positions = pose.positions
    shapes = {}
    facts = []
    weights = wet_weights(scene)
    forces = end_forces(scene, positions[None], pose.tension[None])
    uplift = end_angles(positions[None], whole_lines(scene))
    for line in whole_lines(scene):
        ends = forces[line.name][0], uplift[line.name][0]
        found, shape = _line_facts(scene, line, positions[line.nodes], weights[line.links].sum(), *ends)
        facts.append(found)
        shapes[line.name] = shape
    held = _held_above(scene)
    matrix = None
    if held:
        matrix = stiffness_of_group(build_model(scene), pose.state, held, (0.0, 0.0, 0.0)).matrix
    return Explained(
        lines=tuple(facts),
        wear=tuple(_wear(scene, pose.state)),
        held=held,
        stiffness=matrix,
        closed_stiffness=_closed_stiffness(scene, positions, shapes, held),
        ignored=tuple(scene.notes),
    )


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


def _line_facts(
    scene: Scene, line: WholeLine, nodes: np.ndarray, weight: float, forces: np.ndarray, angles: np.ndarray
) -> tuple[LineFacts, Shape | None]:
    """The facts of a line, and its closed form where that applies.

    Args:
        nodes: its nodes (n + 1, 3) [m]; weight: in water [N].
        forces, angles: (2,) [N] on its points, and (2,) [deg] of its end links.
    """
    spec = line.spec
    order = [0, -1]  # the lower end first
    if nodes[0, 2] > nodes[-1, 2]:
        order = [-1, 0]
    low, high = nodes[order]
    lower, upper = forces[order]
    length = spec.length.sum()
    on_bed = _length_on_bed(scene, line, nodes)
    closed = _closed_form(_hanging(scene, line, low, high, weight / length, on_bed), weight)
    EA = _stiffness_of(spec)
    mass = spec.mass.sum()
    flexibility = np.sum(spec.length / EA)
    damping = np.zeros(1) if spec.axial_damping is None else spec.axial_damping
    rate = np.pi / np.sqrt(flexibility * mass)
    fastest = 2.0 / np.min(spec.length) * np.sqrt(np.max(EA) * length / mass)
    facts = LineFacts(
        name=line.name,
        length_m=length,
        apart_m=float(np.linalg.norm(high - low)),
        on_bed_m=on_bed,
        uplift_deg=angles[order[0]],
        lower_n=lower,
        upper_n=upper,
        closed_lower_n=closed.lower,
        closed_upper_n=closed.upper,
        reserve_m=closed.reserve,
        excess_m=closed.excess,
        axial_n_per_m=1.0 / flexibility,
        horizontal_n_per_m=closed.stiffness,
        axial_period_s=2.0 * np.pi / rate,
        damping_ratio=0.5 * rate * np.mean(damping) * flexibility / length,
        link_damping_ratio=0.5 * fastest * (np.max(damping) / np.max(EA)),
    )
    return facts, closed.shape


class _ClosedForm(NamedTuple):
    """A line by its closed form; None where that does not apply.

    Attributes:
        lower, upper: force on its lower and its upper end point [N].
        reserve, excess, stiffness: `reserve_m`, `excess_m` and `horizontal_n_per_m` of `LineFacts`.
        shape: forces of the form.
    """

    lower: float | None = None
    upper: float | None = None
    reserve: float | None = None
    excess: float | None = None
    stiffness: float | None = None
    shape: Shape | None = None


def _closed_form(hanging: Hanging | None, weight: float) -> _ClosedForm:
    """The closed form of a line of this weight in water [N]; one that floats (below 0) hangs upside down."""
    if hanging is None:
        return _ClosedForm()
    excess = hanging.length - hanging.span - hanging_length(hanging)
    reserve = None
    if hanging.on_bed:
        reserve = offset_until_uplift(hanging)
    shape = solve(hanging)
    if shape is None:
        return _ClosedForm(reserve=reserve, excess=excess)
    stiffness = None
    if shape.stiffness is not None:
        stiffness = shape.stiffness[0, 0]
    if weight < 0.0:
        return _ClosedForm(shape.upper, shape.lower, reserve, excess, stiffness, shape)
    return _ClosedForm(shape.lower, shape.upper, reserve, excess, stiffness, shape)


def _hanging(
    scene: Scene, line: WholeLine, low: np.ndarray, high: np.ndarray, weight: float, on_bed: float
) -> Hanging | None:
    """The line as a uniform one, if it is: no current, no point between its ends, all of it under water."""
    spec = line.spec
    along_line = [spec.length, spec.mass, _stiffness_of(spec), spec.diameter]
    uniform = all(values is not None and np.ptp(values) <= 1e-6 * np.max(values) for values in along_line)
    still = scene.sea is not None and scene.sea.current is None and "bending" not in scene.effects
    simple = len(line.stops) == 2 and weight != 0.0 and spec.axial_law != "tabulated"
    if not (uniform and still and simple) or high[2] > 0.0:
        return None
    across, along, rise = high - low
    return Hanging(
        span=np.hypot(across, along),
        rise=rise,
        length=spec.length.sum(),
        weight=abs(weight),
        EA=_stiffness_of(spec)[0],
        on_bed=weight > 0.0 and on_bed > 0.0,
    )


def _length_on_bed(scene: Scene, line: WholeLine, nodes: np.ndarray) -> float:
    """Unstretched length [m] of the links that rest on the seabed with both nodes."""
    if "seabed" not in scene.effects:
        return 0.0
    length = line.spec.length
    on_bed = nodes[:, 2] - bed_height(scene, nodes) < ON_BED * np.mean(length)
    return np.sum(length[on_bed[1:] & on_bed[:-1]])


def _held_above(scene: Scene) -> tuple[str, ...]:
    """Fixed points at which all lines end with their upper end."""
    height = {point.name: point.position[2] for point in scene.points}
    lower = set()
    ends = set()
    for line in whole_lines(scene):
        first, *_, last = line.stops.values()
        lower.add(min((first, last), key=lambda name: height[name]))
        ends.update(line.stops.values())
    return tuple(name for name in scene.fixed_points if name in ends - lower)


def _closed_stiffness(
    scene: Scene, positions: np.ndarray, shapes: dict[str, Shape | None], held: tuple[str, ...]
) -> tuple[float, float] | None:
    """Sum of the horizontal stiffnesses [N/m] along x and y of the lines at these points, all from a fixed anchor.

    None without such points, and if a line has no closed form, a free end, or hangs straight down.
    """
    if not held:
        return None
    total = np.zeros(2)
    for line in whole_lines(scene):
        ends = set(line.stops.values())
        if not ends & set(held):
            continue
        shape = shapes[line.name]
        if shape is None or shape.stiffness is None or not ends <= set(scene.fixed_points):
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
    predicted = tension + _tension_change(scene, worn, state)
    again = equilibrium(worn)
    found = []
    for line in whole_lines(scene):
        now = tension[line.links]
        load = line.spec.breaking_load
        exact = None
        use = None
        worn_use = None
        if again.status == "ok":
            exact = float(np.max(again.tension[line.links]))
        if load is not None:
            use = float(np.max(now / load))
            if exact is not None:
                worn_use = float(np.max(again.tension[line.links] / (load * WORN_DIAMETER**2)))
        found.append(
            Wear(
                name=line.name,
                tension_n=float(np.max(now)),
                by_derivative_n=float(np.max(predicted[line.links])),
                by_equilibrium_n=exact,
                use=use,
                worn_use=worn_use,
            )
        )
    return found


def _worn_values(scene: Scene) -> Table:
    """Values of the worn scene by path."""
    values: Table = {}
    for i, line in enumerate(scene.lines):
        values[f"line.{i}.mass"] = WORN_DIAMETER**2 * line.mass
        if line.tables is None:
            values[f"line.{i}.axial.EA"] = WORN_DIAMETER**2 * _stiffness_of(line)
        else:
            worn = [replace(table, tension=WORN_DIAMETER**2 * table.tension) for table in line.tables]
            values[f"line.{i}.axial.tension"] = tables_of(worn)["tension"]
        for key in ("diameter", "outer_diameter"):
            if getattr(line, key) is not None:
                values[f"line.{i}.{key}"] = WORN_DIAMETER * getattr(line, key)
    return values


def _tension_change(scene: Scene, worn: Scene, state: State) -> np.ndarray:
    """Change (n,) [N] of the tensions from the scene to the worn one, by the derivative at the scene's equilibrium."""
    model = build_model(scene)
    loads = release_loads(model, scene.start)
    pairs = zip(jax.tree.leaves(model), jax.tree.leaves(build_model(worn)), strict=True)
    change = {}
    for i, (a, b) in enumerate(pairs):
        if np.any(np.asarray(a) != np.asarray(b)):
            change[i] = np.asarray(b) - np.asarray(a)
    rows = [row[None] for row in change.values()]

    def tension(shift: Array) -> Array:
        return settle(shift_model(model, list(change), rows, shift), state, loads, there=True).tension

    return np.asarray(jax.jvp(tension, (jnp.zeros(1),), (jnp.ones(1),))[1])
