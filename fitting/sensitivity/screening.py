"""Global sensitivity: Sobol indices and Morris screening of a function over a box of parameters (SALib)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.run.storage import extra

METHODS = ("sobol", "morris")


@dataclasses.dataclass(frozen=True)
class Global:
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

    def to_json(self) -> dict[str, Any]:
        """The fields."""
        return dataclasses.asdict(self)


def global_indices(
    function: Callable[[np.ndarray], np.ndarray],
    names: Sequence[str],
    box: Sequence[tuple[float, float]],
    method: str = "sobol",
    samples: int = 256,
    seed: int = 0,
) -> Global:
    """Sobol indices or Morris screening of a function of (cases, p) -> (cases,) over a box.

    Sobol takes `samples (p + 2)` runs (samples a power of 2), Morris `samples (p + 1)`.

    Raises:
        SceneError: an unknown method, or cases that failed.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270; Morris, Technometrics 33 (1991) 161-174.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r}; allowed: {', '.join(METHODS)}")
    problem = {"num_vars": len(names), "names": list(names), "bounds": [list(pair) for pair in box]}
    sobol = method == "sobol"
    if sobol and samples & (samples - 1):
        raise SceneError(f"samples: {samples}; allowed: a power of 2, such as {2 ** round(np.log2(samples))}")
    sampler, analyser = (extra(f"SALib.{part}.{method}", "sensitivity") for part in ("sample", "analyze"))
    more = {"calc_second_order": False} if sobol else {}
    points = sampler.sample(problem, samples, seed=seed, **more)
    values = np.asarray(function(points), float)
    bad = int(np.sum(~np.isfinite(values)))
    if bad:
        raise SceneError(f"samples: {bad} of {len(values)} cases failed. Use ranges in which every case runs")
    if np.ptp(values) <= 1e-12 * np.max(np.abs(values)):
        zero = np.zeros(len(names))
        return Global(method, list(names), list(box), zero, zero, zero, zero, len(values), float(values.mean()), 0.0)
    if sobol:
        found = analyser.analyze(problem, values, seed=seed, **more)
        columns = [found[key] for key in ("S1", "S1_conf", "ST", "ST_conf")]
    else:
        found = analyser.analyze(problem, points, values, seed=seed)
        columns = [found["mu_star"], found["mu_star_conf"], found["sigma"], np.full(len(names), np.nan)]
    columns = [np.asarray(column, float) for column in columns]
    return Global(method, list(names), list(box), *columns, len(values), float(values.mean()), float(values.std()))
