"""Damping laws that give the same motion, such as linear drag and a viscous joint of a single link.

Two coefficients act alike if their derivatives of all residuals are parallel. One of them then replaces the other, and
of laws with the same parts after that only one is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fitting.estimate.solution import Solution
from fitting.laws.laws import LAW_PARTS, LAWS, part_of
from fitting.windows.prepared import Prepared

#: Cosine of two coefficients' derivatives above which they count as one. Coefficients of the same motion differ a
#: little: drag is weighted within a step, joints are not.
SAME_COSINE = 1 - 1e-4


def equivalent_laws(laws: Sequence[str], prepared: Prepared, fullest: Solution) -> dict[str, str]:
    """Those of the laws that are not fitted, each with the law of the list that gives the same motion.

    Args:
        fullest: fit of the law with the most parts.
    """
    replaced = _equivalent_parts(laws, prepared, fullest)
    found = {}
    for law in laws:
        parts = {replaced.get(part, part) for part in LAWS[law]}
        same = next((other for other in laws if set(LAWS[other]) == parts), law)
        if same != law:
            found[law] = same
    return found


def _equivalent_parts(laws: Sequence[str], prepared: Prepared, fullest: Solution) -> dict[str, str]:
    """Parts of one coefficient that act like another, which replaces them; a part that the fit already has stays."""
    owner = [part_of(name) for name in fullest.problem.names]
    single = {part for law in laws for part in LAWS[law] if owner.count(part) == 1}
    asked = {part_of(name) for name in prepared.names}
    columns = fullest.evaluation.jacobian[..., fullest.problem.freedoms :].reshape(-1, len(owner))
    unit = columns / np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    replaced: dict[str, str] = {}
    parts = sorted(single, key=lambda part: (part not in asked, list(LAW_PARTS).index(part)))
    for part, other in combinations(parts, 2):
        cosine = abs(unit[:, owner.index(part)] @ unit[:, owner.index(other)])
        if part not in replaced and cosine >= SAME_COSINE:
            replaced[other] = part
    return replaced
