"""Global sensitivity: Sobol indices and Morris screening of a function over a box of parameters (SALib)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.run.storage import extra
from fitting.parameters.names import full_names
from fitting.parameters.targets import Direction
from fitting.sensitivity.problem import Study

#: Methods, and SALib's names of first and total indices with their errors.
METHODS = {"sobol": ("S1", "S1_conf", "ST", "ST_conf"), "morris": ("mu_star", "mu_star_conf", "sigma", "sigma_conf")}
#: Minimum number of samples, for errors that hold: by 4, one of seven Sobol indices is off by more than its own.
MIN_SAMPLES = {"sobol": 8, "morris": 2}
#: Half of the default range of a parameter, as a fraction of it.
RANGE_FRACTION = 0.2


@dataclass(frozen=True)
class GlobalIndices:
    """Indices over a box of parameters.

    Attributes:
        method: `sobol` (first: fraction of the variance by the parameter alone; total: with its interactions) or
            `morris` (first: mean |elementary effect| [unit of the quantity per range]; total: their standard
            deviation).
        names, ranges: of the parameters.
        first, first_error, total, total_error: (p,), errors at 95 % (NaN if not available).
        runs, mean, std: number of runs, mean and standard deviation of the quantity over them.
    """

    method: str
    names: list[str]
    ranges: list[tuple[float, float]]
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    runs: int
    mean: float
    std: float

    #: Cases that fail are rejected before indices are computed.
    finite: ClassVar[bool] = True
    warnings: ClassVar[Sequence[str]] = ()

    def to_json(self) -> dict[str, Any]:
        """The fields."""
        return asdict(self)


def global_indices(
    function: Callable[[np.ndarray], np.ndarray],
    names: Sequence[str],
    box: Sequence[tuple[float, float]],
    method: str = "sobol",
    samples: int = 256,
    seed: int = 0,
) -> GlobalIndices:
    """Sobol indices or Morris screening of a function of (cases, p) -> (cases,) over a box.

    Sobol takes `samples (p + 2)` runs (samples a power of 2), Morris `samples (p + 1)`.

    Raises:
        SceneError: an unknown method, too few samples, or cases that failed.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270; Morris, Technometrics 33 (1991) 161-174.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r}; allowed: {', '.join(METHODS)}")
    if samples < MIN_SAMPLES[method]:
        raise SceneError(f"samples: {samples}; allowed: a whole number >= {MIN_SAMPLES[method]}")
    problem = {"num_vars": len(names), "names": list(names), "bounds": [list(pair) for pair in box]}
    sobol = method == "sobol"
    settings = {}
    if sobol:
        settings["calc_second_order"] = False
        if samples.bit_count() > 1:
            raise SceneError(f"samples: {samples}; allowed: a power of 2, such as {2 ** round(np.log2(samples))}")
    sampler = extra(f"SALib.sample.{method}", "sensitivity")
    analyser = extra(f"SALib.analyze.{method}", "sensitivity")
    points = sampler.sample(problem, samples, seed=seed, **settings)
    values = np.asarray(function(points), float)
    bad = int(np.sum(~np.isfinite(values)))
    if bad:
        raise SceneError(f"samples: {bad} of {len(values)} cases failed. Use ranges in which every case runs")
    indices = dict.fromkeys(METHODS[method], np.zeros(len(names)))
    if np.ptp(values) <= 1e-12 * np.max(np.abs(values)):  # rounding only
        values = np.full_like(values, values.mean())
    elif sobol:
        indices = analyser.analyze(problem, values, seed=seed, **settings)
    else:
        indices = {"sigma_conf": np.full(len(names), np.nan), **analyser.analyze(problem, points, values, seed=seed)}
    columns = [np.asarray(indices[key], float) for key in METHODS[method]]
    return GlobalIndices(
        method, list(names), list(box), *columns, len(values), float(values.mean()), float(values.std())
    )


def parameter_ranges(
    problem: Study, given: Mapping[str, tuple[float, float]] | None = None
) -> list[tuple[float, float]]:
    """Range of each parameter in a global study: the given one, otherwise +-20 %, inside its bounds.

    Raises:
        SceneError: an empty range, one out of the parameter's bounds or of no parameter of the study, or a parameter
            that ranges cannot vary.
    """
    given = given or {}
    full: dict[str, tuple[float, float]] = {}
    for name, (low, high) in zip(full_names(problem.scene, list(given), "range"), given.values(), strict=True):
        if name not in problem.names or name in full or not low < high:
            raise SceneError(f"range: {name} = {low:g}:{high:g}; allowed: low < high, once for a parameter of --to")
        full[name] = (low, high)
    found = []
    for p in problem.parameters:
        if isinstance(p.where, Direction) and not p.where.linear:
            raise SceneError(
                f"to: the model is not linear in {p.name!r}. Use it in local studies, or in `dropper sweep`"
            )
        spread = RANGE_FRACTION * p.scale
        low, high = full.get(p.name, (max(p.low, p.value - spread), min(p.high, p.value + spread)))
        if not p.low <= low < high <= p.high:
            raise SceneError(f"range: {p.name} = {low:g}:{high:g} is out of bounds; allowed: {p.bounds_in_words}")
        found.append((low, high))
    return found
