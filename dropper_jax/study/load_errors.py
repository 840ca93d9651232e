"""Error bars of loads: errors of the tensions of a run due to its step, its links, and chance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.read import Plain, Table, declared_fields
from dropper_jax.effects import EFFECTS
from dropper_jax.evaluation.record import Record, arc, record
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.snaps import line_snaps
from dropper_jax.load.periods import periods
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.companion import error_factor, finer_values, parts_at
from dropper_jax.run.samples import Samples, is_finished
from dropper_jax.sea.make import main_period

#: Quantities of a link or a node that are divided between its halves; all others are equal.
SHARED = ("N", "kg", "kg/s", "kg/m")
#: Keys of a line per link.
PER_LINK = {"length": 2, "mass": 2, "diameter": 1, "breaking_load": 1}


def twice_the_links(scene: Scene) -> Scene:
    """The scene with each link divided into halves; axial stiffness and internal damping do not change.

    Raises:
        SceneError: unsupported scenes: compound links, a single rigid link, joint friction.
    """
    if any(line.centre_of_mass is not None for line in scene.lines):
        raise SceneError("line.centre_of_mass: compound links have no halves; allowed: lines of simple links")
    if all(line.rigid and line.links == 1 for line in scene.lines):
        raise SceneError("line.links: a single rigid link is the body itself; allowed: lines of several links")
    if "joint_friction" in scene.effects:
        raise SceneError("effects.joint_friction: depends on the number of joints. Use a scene without it")
    table = scene.to_dict()
    table["line"] = [_line(line) for line in table["line"]]
    table["effects"] = {name: _effect(name, values) for name, values in table["effects"].items()}
    table["start"] = _start(table["start"])
    for failure in table.get("failure", ()):
        if failure.get("link") is not None:
            failure["link"] = 2 * failure["link"] - 1
    return load_scene(table)


def _line(line: Table) -> Table:
    """A line of a scene with twice the links."""
    halves = {key: _halve_value(line[key], parts) for key, parts in PER_LINK.items() if key in line}
    if "axial" in line:
        halves["axial"] = {key: _halve_value(value, 1) for key, value in line["axial"].items()}
    return {**line, **halves, "links": 2 * line["links"]}


def _effect(name: str, values: Table) -> Table:
    """An effect of a scene with twice the links: values per link or node, and numbers of nodes."""
    found = dict(values)
    for field in declared_fields(EFFECTS[name]).values():
        key = field.name
        if found.get(key) is not None and field.metadata.get("shape") in ("link", "node"):
            parts = 2 if field.metadata.get("unit") in SHARED else 1
            found[key] = _halve_value(found[key], parts)
    for key in ("node", "nodes"):  # of one line, counted from 1
        if found.get(key) is not None and isinstance(found[key], list | int) and not isinstance(found[key], bool):
            found[key] = (2 * np.asarray(found[key])).tolist()
    return found


def _start(start: Table) -> Table:
    """The start of a scene with twice the links: new nodes are in the middle of links."""
    found = dict(start)
    for key in ("polar", "azimuth", "polar_rate", "azimuth_rate"):
        if found.get(key) is not None:
            found[key] = np.repeat(found[key], 2).tolist()
    for key in ("positions", "velocities"):
        if found.get(key) is not None:
            given = np.asarray(found[key], float)
            middles = 0.5 * (given[:-1] + given[1:])
            found[key] = np.insert(given, np.arange(1, len(given)), middles, axis=0).tolist()
    if found.get("release_nodes") is not None:
        found["release_nodes"] = [2 * node for node in found["release_nodes"]]
    return found


def _halve_value(value: Plain, parts: int) -> Plain:
    """Value of each half of a link, from a number or a list of one per link."""
    if isinstance(value, list):
        return [_halve_value(x, parts) for x in value for _ in (0, 1)]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value / parts
    return value


#: Loads of each line: mean and standard deviation in time of the link with the maximum tension [N], mean of the maxima
#: in windows of a wave [N], maximum and minimum [N], number of snaps.
QUANTITIES = ("mean", "deviation", "window_maximum", "maximum", "minimum", "snaps")
#: Loads that depend on few instants and converge irregularly: their error is the whole difference of two runs.
EXTREMES = ("maximum", "minimum", "snaps")
#: Factor on an estimated error so that the true one rarely exceeds it (Roache, J. Fluids Eng. 116 (1994) 405).
GRID_SAFETY = 1.25
#: Relative error of the maximum tension of a line above which it is not resolved.
UNRESOLVED = 0.05


def load_errors(
    scene: Scene,
    run: Callable[[Scene], Samples],
    skip: float = 0.0,
    first: Samples | None = None,
    say: Progress = silent,
) -> Table:
    """Loads of a run with an estimate of their error.

    The scene is also run finer (half the step, a quarter of the accuracy), with twice the links at the same EA and BA
    and, if present, with twice the internal damping and twice the stiffness of the seabed, for some six times the time
    of a single run. With q a load, g the gain of the finer run as in `run.companion`,

        step:  1.25 |q - q_finer| g/(g - 1), for extremes and counts 1.25 |q - q_finer|,
        links: 1.25 (2 |q - q'|),    q' with twice the links.

    Links are taken as of first order, to which masses at nodes, contact and slack reduce them. The total is the sum of
    both; the factor 1.25 (Roache 1994) turns the estimate into a limit. `chance` is the standard error by batch means
    (8 batches; for maxima from the spread of the window maxima). It estimates the change in another storm of the same
    length and is not an error of this one. Once the two runs are different motions (`chaotic`, from `horizon_s` on),
    differences of single runs are random, and the error of the step is the whole difference for all loads.

    Args:
        run: simulates a scene.
        skip: time left out at the start [s].
        first: the run of the scene itself, if available.

    Returns:
        `loads`: rows by line {line, at_m, and by quantity {value, step, links, chance, error, twice_damping,
        twice_bed}}; `chaotic`, `horizon_s`; `not_resolved`: lines whose maximum tension has an error of 5 % or more;
        `left_out`: variants that were not run, and the reason.

    Raises:
        SceneError: a failed run, or a record that is too short.
    """
    variants, left_out = _variants(scene)
    base = run(scene) if first is None else first
    _must_have_ended(base, "of the scene")
    made = {"1": line_loads(record(base, skip))}
    horizon = None
    for i, (name, variant) in enumerate(variants.items(), start=1):
        say(i / (1 + len(variants)), name)
        solution = run(variant)
        if name == "finer":
            _must_have_ended(solution, "with half its step")
            horizon = parts_at(base, solution)
        elif not has_ended(solution):
            left_out[name] = f"that run ends with {solution.failure}"
            continue
        made[name] = line_loads(record(solution, skip), made["1"])
    chaotic = horizon is not None
    factor = 1.0
    if horizon is None:
        factor = error_factor(base, finer=True)
        horizon = scene.run.duration
    rows = []
    for i in range(len(made["1"])):
        of_line = {name: loads[i] for name, loads in made.items()}
        rows.append(_row(of_line, factor))
    return {
        "loads": rows,
        "chaotic": chaotic,
        "horizon_s": horizon,
        "not_resolved": [row["line"] for row in rows if row["maximum"]["error"] > UNRESOLVED * row["maximum"]["value"]],
        "left_out": left_out,
    }


def has_ended(solution: Samples) -> bool:
    """Whether a run has loads to compare."""
    return len(solution.t) > 3 and is_finished(solution)


def _must_have_ended(solution: Samples, which: str) -> None:
    if not has_ended(solution):
        raise SceneError(f"--errors: the run {which} ends with {solution.failure}")


def _variants(scene: Scene) -> tuple[dict[str, Scene], dict[str, str]]:
    """The scenes of the further runs by name, and those left out with the reason."""
    left_out = {}
    found = {"finer": scene.with_values(finer_values(scene.run))}
    try:
        found["links"] = twice_the_links(scene)
    except SceneError as error:
        left_out["links"] = str(error)
    damped = {}
    for i, line in enumerate(scene.lines):
        if line.axial_damping is not None:
            damped[f"line.{i}.axial.damping"] = 2.0 * line.axial_damping
    if damped:
        found["twice_damping"] = scene.with_values(damped)
    if "seabed" in scene.effects:
        stiffness = 2.0 * float(scene.effects["seabed"]["stiffness"])
        found["twice_bed"] = scene.with_values({"effects.seabed.stiffness": stiffness})
    return found, left_out


def line_loads(found: Record, like: list[Table] | None = None) -> list[Table]:
    """Per line its loads {line, at_m, name: (value, standard error by chance)}, see `QUANTITIES`.

    They are those of the link with the maximum tension, or at the arc length in `like` (loads of another run).
    """
    snaps = line_snaps(found, Settings())
    within = found.square - found.tension**2
    rows = []
    for i, where in enumerate(found.written_lines):
        s = arc(where.spec.length)
        extremes = found.extremes["tension"].of(where.links)
        if like is None:
            at = s[int(np.argmax(extremes.largest.max(axis=0)))]
        else:
            at = like[i]["at_m"]
        arrays = (found.tension[:, where.links], extremes.least, extremes.largest, within[:, where.links])
        statistics = _statistics(found, *(_at(values, s, at) for values in arrays))
        rows.append({"line": where.name, "at_m": at, **statistics, "snaps": (snaps[i]["most_events"], 0.0)})
    return rows


def _at(values: np.ndarray, s: np.ndarray, at: float) -> np.ndarray:
    """Values (q, n) of links with their middles at arc lengths s (n,), linear between them."""
    row = np.interp(at, s, np.arange(len(s)))
    low = min(int(row), max(len(s) - 2, 0))
    share = row - low
    if share == 0:
        return values[:, low]
    return (1.0 - share) * values[:, low] + share * values[:, low + 1]


def _statistics(
    found: Record, tension: np.ndarray, least: np.ndarray, largest: np.ndarray, within: np.ndarray
) -> dict[str, tuple[float, float]]:
    """Loads at one position of a line (q,) [N], each with its random standard error; `within` is the variance in a
    sample."""
    square = tension**2 + within
    tops = _windows(found, largest)
    bottoms = _windows(found, -least)
    batches = [part for part in np.array_split(np.arange(len(tension)), 8) if part.size]
    means = np.array([tension[part].mean() for part in batches])
    deviations = np.array([_deviation(tension[part], square[part]) for part in batches])
    return {
        "mean": (tension.mean(), _spread(means) / np.sqrt(len(means))),
        "deviation": (_deviation(tension, square), _spread(deviations) / np.sqrt(len(deviations))),
        "window_maximum": (tops.mean(), _spread(tops) / np.sqrt(len(tops))),
        # maximum of many: the same spread as one window maximum (a Gumbel distribution keeps its scale)
        "maximum": (tops.max(), _spread(tops)),
        "minimum": (-bottoms.max(), _spread(bottoms)),
    }


def _deviation(values: np.ndarray, squares: np.ndarray) -> float:
    """Standard deviation of values with these squares."""
    return np.sqrt(max(squares.mean() - values.mean() ** 2, 0.0))


def _spread(values: np.ndarray) -> float:
    """Standard deviation of a sample; NaN of one value."""
    return values.std(ddof=1) if len(values) > 1 else float("nan")


def _windows(found: Record, values: np.ndarray) -> np.ndarray:
    """Maxima in windows of a peak period, or of 10 s; the full record if it is shorter."""
    sea = found.scene.sea
    period = 10.0
    if sea is not None and sea.waves is not None:
        period = periods(found.scene).get("waves") or main_period(sea, sea.waves)
    count = max(int(found.duration / period), 1)
    edges = np.linspace(found.t_tension[0], found.t_tension[-1] + found.interval, count + 1)
    window = np.clip(np.digitize(found.t_tension, edges) - 1, 0, count - 1)
    return np.array([values[window == i].max() for i in range(count) if np.any(window == i)])


def _row(made: dict[str, Table], factor: float) -> Table:
    """Loads of a line with their errors, from those of the run (`1`) and of its variants."""
    first = made["1"]
    row: Table = {"line": first["line"], "at_m": first["at_m"]}
    for name in QUANTITIES:
        value, chance = first[name]
        change = {key: loads[name][0] - value for key, loads in made.items()}
        own = 1.0 if name in EXTREMES else factor
        step = GRID_SAFETY * own * abs(change["finer"])
        links = None
        if "links" in change:
            links = GRID_SAFETY * 2.0 * abs(change["links"])
        if np.isnan(chance):
            chance = None
        row[name] = {"value": value, "step": step, "links": links, "chance": chance, "error": step + (links or 0.0)}
        for key in ("twice_damping", "twice_bed"):
            if key in change:
                row[name][key] = change[key]
    return row
