"""`optimise`: from a site to a design, with a check of its derivatives, in a search that can be resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.study.gradient_check import NOT_TRUSTED, TRUSTED, GradientCheck, check_gradient
from fitting.farm.optimise.design import Design
from fitting.farm.optimise.goals import read_goals
from fitting.farm.optimise.models import ASSUMPTIONS
from fitting.farm.optimise.search import MAX_RESIDUAL, Search, Start, constraints_by_name, programme, run_search
from fitting.farm.optimise.settings import Settings
from fitting.farm.optimise.shadow_prices import shadow_prices
from fitting.farm.optimise.values import Dominated, Values, dominated_slopes
from fitting.farm.optimise.variables import Variable, bounds, read_variables
from fitting.farm.optimise.windows import Window
from fitting.farm.site import Site

#: Value above which a constraint is called active.
ACTIVE_FROM = 0.97
#: Meaning of `run.characteristic`, in words.
CHARACTERISTIC = {
    "mean": "mean of the seeds' maxima",
    "most_probable": "most probable largest value of a storm by the seeds' maxima",
}
#: Minimum fraction of the objective's slope that the constraints of an optimum balance.
MIN_BALANCED = 0.9


@dataclass(frozen=True)
class Optimum:
    """Result of the search.

    Attributes:
        variables, before, after: and their values (p,); `after` is the best design whose whole runs meet all
            constraints, or the end of the search if none does (`feasible` False).
        objective: before and after.
        constraints: by name, before and after (whole runs).
        prices: by name of an active constraint, change of the objective for 1 % more of its limit.
        assumptions: by name, change of the objective for 1 % more, with the design adapted.
        characteristic: statistic of the seeds' maxima that the constraints apply to.
        residual: maximum difference, in limits, of constraints by windows (soft peaks times factors) from those of
            whole runs at `after`, before windows and factors were updated there; NaN if the start was the best.
        held: fraction of the objective's slope at `after` that active constraints and bounds balance: 1 at an optimum.
        along: two runs of a window along the gradient of its highest peak, before the search.
        warnings: reasons to doubt the result.
        dominated: derivatives of active constraints by variable that one seed dominates, with their mean and median.
    """

    variables: tuple[Variable, ...]
    before: np.ndarray
    after: np.ndarray
    of: str
    objective: tuple[float, float]
    constraints: dict[str, tuple[float, float]]
    prices: dict[str, float]
    assumptions: dict[str, float]
    feasible: bool
    residual: float
    held: float
    rounds: int
    runs: int
    history: list[Table]
    warnings: tuple[str, ...]
    characteristic: str
    dominated: tuple[Table, ...]
    along: GradientCheck

    @property
    def gain(self) -> float:
        """Relative decrease of the objective."""
        return 1.0 - self.objective[1] / self.objective[0]

    def to_json(self) -> Table:
        """Plain values."""
        along = self.along
        found = {**asdict(self), "gain": self.gain, "check": along_error(along), "along": along._asdict()}
        return {key: jsonable(value) for key, value in found.items()}


def read_problem(site: Site) -> Design:
    """The design problem of a site, checked.

    Raises:
        SceneError: for any invalid input, before anything runs.
    """
    variables = read_variables(site.raw.get("variable", []), site.scene)
    if None not in site.states:
        raise SceneError("cases.states: must include 'intact', because the intact farm is optimised")
    return Design(site, variables, read_goals(site), Settings.read(site.raw.get("optimise", {}), "optimise"))


def optimise(site: Site, state: str | Path | None = None, say: Progress = silent) -> Optimum:
    """The best design of a site.

    Args:
        state: file that stores the search after every step; an existing one is resumed.

    Raises:
        SceneError: a site that cannot be used, constraints that no design within the bounds meets to first order, or
            runs that fail.
    """
    design = read_problem(site)
    file = None if state is None else Path(state)
    mark = _mark(design)
    search, along = _resume_search(file, mark, design)

    def save() -> None:
        if file is not None:
            table = {"site": mark, "along": along._asdict(), **asdict(search)}
            atomic_write(file, json.dumps(jsonable(table)))

    if search.before is None:
        _check_depths(design)
        along = check_along(design, say)
        save()
    start = search.before
    if start is None or not search.done:
        start = run_search(search, design, save, say)
    return _optimum(design, search, start, along, say)


def _check_depths(design: Design) -> None:
    """Reject depths at rest that no design within the bounds meets to first order, before any storm is run."""
    low, high = bounds(design.variables)
    for storm in {storm.still: storm for storm in design.site.storms}.values():
        rows = design.depths(design.start, storm)
        if not rows:
            continue
        names, value, slopes = zip(*rows, strict=True)
        values = Values(0.0, np.zeros(len(low)), names, np.array(value), np.array(slopes))
        step = programme(values, low - design.start, high - design.start, 1.0, 1.0)
        if step.violation > 1e-3:
            left = values.value + values.slopes[:, : len(low)] @ step.step
            raise SceneError(
                f"constraint: {names[int(np.argmax(left))]} cannot be met together with the others within the "
                "variables' bounds; use wider bounds, or limits that do not contradict"
            )


def _mark(design: Design) -> str:
    """Digest of the inputs that a state belongs to."""
    site = design.site
    table = {
        "scene": site.scene.to_dict(),
        "raw": site.raw,
        "run": str(site.run),
        "cases": [c.storm.name for c in site.cases],
    }
    return hashlib.sha256(json.dumps(jsonable(table), sort_keys=True, default=str).encode()).hexdigest()


def _resume_search(file: Path | None, mark: str, design: Design) -> tuple[Search, GradientCheck]:
    """The search of a state's file, with its check of derivatives; a new one without a file.

    Raises:
        SceneError: a file that is not a state, or belongs to other inputs.
    """
    if file is None or not file.exists():
        return Search(design.start, design.settings.reach), GradientCheck(np.nan, np.nan, np.nan, NOT_TRUSTED)
    try:
        table: Table = json.loads(file.read_text(encoding="utf-8"))
        site = table.pop("site")
        along: Table = table.pop("along")
        for key, x in along.items():
            if x is None:
                along[key] = np.nan
        for key in ("x", "best", "fixed"):
            if table[key] is not None:
                table[key] = np.array(table[key])
        if table["best_objective"] is None:
            table["best_objective"] = np.inf
        if table["before"] is not None:
            table["before"] = Start(**table["before"])
        found = Search(**table), GradientCheck(**along)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise SceneError(
            f"--state: {str(file)!r} is not a state of a search. Use one that it wrote, or a new file"
        ) from None
    if site != mark:
        raise SceneError(f"--state: {str(file)!r} belongs to another site or version of it. Use its own, or a new file")
    return found


def _optimum(design: Design, search: Search, before: Start, along: GradientCheck, say: Progress) -> Optimum:
    """The end of a search: constraints of whole runs, prices, assumptions."""
    feasible = search.best is not None
    if feasible:
        search.x = search.best
    say(0.95, "final whole runs and prices")
    windows, found = design.measure(search.x, say)
    here = design.values(design.differentiate(design.run_windows(search.x, windows, say), say, assumptions=True))
    p = len(design.variables)
    limit = 1.0 - design.settings.margin
    low, high = bounds(design.variables)
    fixed = np.zeros(p, bool) if search.fixed is None else np.asarray(search.fixed, bool)
    price = shadow_prices(here, search.x, low, high, fixed, limit)
    costs = here.slope[p:] + price.by_constraint @ here.slopes[:, p:]
    dominated = dominated_slopes(here, high - low, limit)
    rows = []
    for one in dominated:
        name = design.variables[one.variable].name
        rows.append({**one._asdict(), "variable": name, "seed": design.site.run.first_seed + one.seed})
    residual = np.nan if search.best_residual is None else search.best_residual
    return Optimum(
        variables=design.variables,
        before=np.array(before.x),
        after=search.x,
        of=design.goals.objective.of,
        objective=(before.objective, found.objective),
        constraints={n: (before.constraints[n], after) for n, after in constraints_by_name(found).items()},
        prices={n: -0.01 * float(by) for n, by in zip(here.names, price.by_constraint, strict=True) if by > 0},
        assumptions={n: 0.01 * float(c) for n, c in zip(ASSUMPTIONS, costs, strict=True)},
        feasible=feasible,
        residual=residual,
        held=1.0 - price.unbalanced,
        rounds=search.round,
        runs=len(search.history),
        history=search.history,
        characteristic=CHARACTERISTIC[design.site.run.characteristic],
        along=along,
        warnings=tuple(design_warnings(residual, 1.0 - price.unbalanced, search.reach, dominated, along)),
        dominated=tuple(rows),
    )


def design_warnings(
    residual: float,
    held: float,
    reach: float,
    dominated: Sequence[Dominated] = (),
    along: GradientCheck | None = None,
) -> list[str]:
    """Reasons to doubt a design's numbers, one line each; `reach` is that of the last steps."""
    reasons = [
        (
            residual > MAX_RESIDUAL,
            f"windows and whole runs differed by {residual:.1%} of a limit where the design was found (limit "
            f"{MAX_RESIDUAL:.0%}); its constraints are those of whole runs, but the search used others. Use a longer "
            "optimise.window, a smaller optimise.renew or more seeds to reduce the difference",
        ),
        (
            held < MIN_BALANCED,
            f"active constraints and bounds balance {max(held, 0.0):.0%} of the objective's slope (an optimum: at "
            f"least {MIN_BALANCED:.0%}): effects of 1 % changes are unreliable. Use more optimise.rounds",
        ),
        (
            reach < 0.01,  # such as after the snap of a slack rope
            f"derivatives predict changes of up to {reach:.2%} of the variables' ranges only: effects of 1 % changes "
            "are unreliable. Compare designs by their whole runs",
        ),
        (
            bool(dominated),  # such as by a rope that becomes taut at the peak
            f"one seed dominates {len(dominated)} derivative(s) of active constraints: their mean and median differ in "
            "what they predict. Use more run.seeds, and compare designs by their whole runs",
        ),
    ]
    if along is not None:
        untrusted = f"{along_text(along)}: not_trusted. Compare designs by their whole runs"
        reasons.append((along.status != TRUSTED, untrusted))
    return [reason for applies, reason in reasons if applies]


def along_error(along: GradientCheck) -> float:
    """Relative error of the derivative along the gradient."""
    return abs(along.ratio - 1.0)


def along_text(along: GradientCheck) -> str:
    """What two runs along the gradient show."""
    return f"two runs along the gradient change the highest peak by {along.ratio:.3g} of what it predicts"


def check_along(design: Design, say: Progress = silent) -> GradientCheck:
    """Two runs of a window along the gradient of its highest peak, by 0.5 % of the variables' ranges, at the start of a
    design: the worst window."""
    say(0.0, "two runs along the gradient")
    span = np.array([v.span for v in design.variables])
    found = []
    for window in first_windows(design):
        peaks = design.window(design.start, window)
        (slopes,) = design.slopes([peaks], silent)
        highest = int(np.argmax(peaks.hard))

        def peak(x: np.ndarray, window: Window = window, highest: int = highest) -> float:
            return design.window(np.asarray(x), window).soft[highest]

        found.append(check_gradient(peak, design.start, slopes[highest, : len(span)], span))
    return max(found, key=lambda one: np.nan_to_num(abs(one.ratio - 1.0), nan=np.inf))


def first_windows(design: Design) -> list[Window]:
    """A window of one case of each kind, from the start of the storm."""
    windows = []
    for kind, quantities in design.quantities.items():
        case = next(case for case in design.cases if case.storm.kind == kind)
        begin = Window(case, 0.0, np.ones(len(quantities)))
        windows.append(replace(begin, height=design.window(design.start, begin).hard))
    return windows
