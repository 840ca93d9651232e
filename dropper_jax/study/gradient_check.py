"""Check a gradient of a run: its predicted change against the measured one, for a change of engineering size."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from dropper_jax.base.errors import SceneError

#: A number, an array or a tree of arrays.
Tree = TypeVar("Tree")
#: Relative change of the number to which the function is most sensitive.
RELATIVE_CHANGE = 0.005
#: Difference of the measured and the predicted change, over the predicted one, up to which a gradient is trusted.
MAX_DIFFERENCE = 0.1
#: Values of `GradientCheck.status`.
TRUSTED = "trusted"
NOT_TRUSTED = "not_trusted"


class GradientCheck(NamedTuple):
    """Change of a function between two points along its gradient.

    Attributes:
        predicted, measured: by the gradient, and by the function at both points.
        ratio: measured over predicted; of a predicted change of 0: 1 if the measured one is 0, otherwise NaN.
            `check_gradient` gives NaN for a gradient that is 0 or not finite.
        status: `trusted`, or `not_trusted` if both changes differ by more than 10 % of the predicted one.
    """

    predicted: float
    measured: float
    ratio: float
    status: str

    @classmethod
    def of(cls, predicted: float, measured: float, rounding: float = 0.0) -> GradientCheck:
        """The check of two changes; a difference up to `rounding` is allowed."""
        if predicted:
            ratio = measured / predicted
        elif measured == 0.0:
            ratio = 1.0
        else:
            ratio = np.nan
        status = NOT_TRUSTED
        if abs(measured - predicted) <= max(MAX_DIFFERENCE * abs(predicted), rounding):
            status = TRUSTED
        return cls(predicted, measured, ratio, status)


def check_gradient(
    function: Callable[[Tree], float | Array],
    x: Tree,
    gradient: Tree,
    scale: Tree | None = None,
    size: float = RELATIVE_CHANGE,
) -> GradientCheck:
    """Whether a gradient, such as that of `jax.grad` through a run, predicts a change of engineering size.

        d = h s (s g)/max |s g|,    predicted 2 g.d,    measured f(x + d) - f(x - d)

    In a chaotic run even an exact gradient does not predict such a change. Only a change of this size shows that.

    Args:
        function: of x, to a number; two evaluations.
        x: numbers, an array or a tree of arrays; `gradient` has the same form.
        scale: typical sizes s of the numbers, in the same form; by default their values, so that zeros do not change.
        size: relative change h of the number to which the function is most sensitive.

    Raises:
        SceneError: gradient or scale have another form than x, or size is not between 0 and 1.
    """
    if not 0.0 < size < 1.0:
        raise SceneError(f"size: {size:g}; allowed: above 0 and below 1")
    if scale is None:
        scale = x
    for name, tree in (("gradient", gradient), ("scale", scale)):
        if jax.tree.map(np.shape, tree) != jax.tree.map(np.shape, x):
            raise SceneError(f"{name}: has another form than x; allowed: a number for each number of x")
    at, restore = ravel_pytree(x)
    slope = np.asarray(ravel_pytree(gradient)[0], float)
    sizes = np.abs(np.asarray(ravel_pytree(scale)[0], float))
    matters = slope * sizes
    largest = np.max(np.abs(matters), initial=0.0)
    if not 0.0 < largest < np.inf:
        return GradientCheck(largest, np.nan, np.nan, NOT_TRUSTED)
    step = size * sizes * matters / largest
    high = float(function(restore(at + step)))
    low = float(function(restore(at - step)))
    return GradientCheck.of(2.0 * float(slope @ step), high - low)
