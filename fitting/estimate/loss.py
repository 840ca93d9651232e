"""Loss of residuals in units of their noise: least squares, or a robust loss that reduces the weight of outliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import ndtr

from dropper_jax.base.errors import SceneError, nearest, require_positive


class Loss:
    """A sum over residuals r of a function that is `r^2/2` near zero; itself `r^2/2` throughout, for normal noise.

    Attributes:
        redescends: whether the slope returns to zero, so that outliers lose their weight.
    """

    redescends: ClassVar[bool] = False

    def squares(self, residual: np.ndarray) -> np.ndarray:
        """Contributions to the variance of the noise, of the residuals' shape: of mean 1 for standard normal ones."""
        return residual**2

    def cost(self, residual: np.ndarray) -> float:
        """The sum over all residuals."""
        return 0.5 * float(np.sum(residual**2))

    def weights(self, residual: np.ndarray) -> np.ndarray:
        """Slope over r, of the residuals' shape: weights with which least squares has the same slope."""
        return np.ones_like(residual)

    def curvature(self, residual: np.ndarray) -> np.ndarray:
        """Derivative of the slope, of the residuals' shape."""
        return np.ones_like(residual)


LEAST_SQUARES = Loss()


@dataclass(frozen=True)
class Huber(Loss):
    """`r^2/2` up to `threshold`, in standard deviations, and `threshold |r| - threshold^2/2` beyond (Huber 1964)."""

    threshold: float = 3.0

    def __post_init__(self) -> None:
        require_positive("huber", self.threshold, " standard deviations")

    def squares(self, residual: np.ndarray) -> np.ndarray:
        c = self.threshold
        density = np.exp(-0.5 * c**2) / np.sqrt(2 * np.pi)
        normal = 2 * ndtr(c) - 1 - 2 * c * density + 2 * c**2 * ndtr(-c)  # mean square of the slope
        return np.minimum(np.abs(residual), c) ** 2 / normal

    def cost(self, residual: np.ndarray) -> float:
        size = np.abs(residual)
        c = self.threshold
        return float(np.sum(np.where(size <= c, 0.5 * size**2, c * size - 0.5 * c**2)))

    def weights(self, residual: np.ndarray) -> np.ndarray:
        return np.minimum(1.0, self.threshold / np.maximum(np.abs(residual), 1e-300))

    def curvature(self, residual: np.ndarray) -> np.ndarray:
        return (np.abs(residual) <= self.threshold).astype(float)


@dataclass(frozen=True)
class StudentT(Loss):
    """`nu/2 log(1 + r^2/nu)`, of Student's t with `nu` degrees of freedom: outliers lose their weight (Lange 1989).

    It may have several minima, so that a fit with it starts at the end of one with Huber's loss.
    """

    freedom: float = 4.0
    redescends: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_positive("student", self.freedom, " degrees of freedom")

    def squares(self, residual: np.ndarray) -> np.ndarray:
        """Weight times square. The square of the slope returns to zero and would not determine the variance: a smaller
        assumed noise would leave a smaller sum."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(80)
        normal = weights @ (self.weights(nodes) * nodes**2) / weights.sum()
        return self.weights(residual) * residual**2 / normal

    def cost(self, residual: np.ndarray) -> float:
        return 0.5 * self.freedom * float(np.sum(np.log1p(residual**2 / self.freedom)))

    def weights(self, residual: np.ndarray) -> np.ndarray:
        return 1 / (1 + residual**2 / self.freedom)

    def curvature(self, residual: np.ndarray) -> np.ndarray:
        share = residual**2 / self.freedom
        return (1 - share) / (1 + share) ** 2


#: Losses by name; a fit with a loss that redescends starts with Huber's.
LOSSES: dict[str, Loss] = {"squares": LEAST_SQUARES, "huber": Huber(), "student": StudentT()}


def as_loss(given: Loss | str, option: str = "loss") -> Loss:
    """A loss, or that of a name.

    Raises:
        SceneError: an unknown name.
    """
    if isinstance(given, Loss):
        return given
    if given not in LOSSES:
        raise SceneError(f"{option}: {given!r} is unknown; {nearest(str(given), LOSSES)}")
    return LOSSES[given]


def initial_loss(loss: Loss) -> Loss:
    """The initial loss: one with a single minimum."""
    if loss.redescends:
        return LOSSES["huber"]
    return loss
