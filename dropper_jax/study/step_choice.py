"""Choosing the step of a run by a short pilot (Richardson)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.residual import Stepper
from dropper_jax.run.build import build, equal_steps
from dropper_jax.study.march import grid_run, link_vectors, rms_angle, status_of
from dropper_jax.study.reference import trusted_span

#: Halvings between the two pilot runs: they differ by 3/4 (first order) or 15/16 (second) of the error.
HALVINGS_BETWEEN = 2


@dataclass(frozen=True)
class StepChoice:
    """A step and its estimated error.

    Attributes:
        dt: the step [s].
        estimate: RMS angle between the links of the run and of the exact motion [rad], up to `until`.
        until: time up to which the estimate is valid [s]: later, chaos has amplified any error 100 times.
    """

    dt: float
    estimate: float
    until: float

    def summary(self) -> dict[str, float]:
        return {"rms_angle_rad": self.estimate, "until_s": self.until}


def choose_step(scene: Scene, tolerance: float) -> StepChoice:
    """The largest of the scene's step times 2^k (k whole) whose estimated error meets `tolerance` [rad].

    Each candidate h is compared with a run of h/4; the error of h is their difference over `1 - 4^-p`, p the observed
    order. Candidates are the scene's step times powers of two, so that releases and tables stay on whole steps.

    Raises:
        SceneError: a tolerance that no step down to 2^-12 of the scene's meets.
    """
    safety = 0.8  # fraction of the tolerance that the estimate may reach: it is accurate to a factor only
    if not (isinstance(tolerance, int | float) and 0 < tolerance < math.inf):
        raise SceneError(f"tolerance: {tolerance!r} is out of range; allowed: an RMS angle error > 0 rad")
    pilot = _Pilot(scene)
    k = 0
    error = pilot.error(0)
    while error > safety * tolerance:
        k -= 1
        if not pilot.affordable(k):
            raise SceneError(
                f"tolerance: {tolerance:g} rad is not reached with {pilot.dt(k + 1):.3g} s, whose error is "
                f"{error:.2g} rad. Use a larger tolerance or another integrator"
            )
        error = pilot.error(k)
    while k >= 0 and pilot.sensible(k + 1) and (larger := pilot.error(k + 1)) <= safety * tolerance:
        k, error = k + 1, larger
    return StepChoice(pilot.dt(k), error, pilot.until)


def estimate_error(scene: Scene) -> StepChoice:
    """The same estimate for the step of the scene."""
    pilot = _Pilot(scene)
    return StepChoice(pilot.dt(0), pilot.error(0), pilot.until)


class _Pilot:
    """Runs of one scene with steps `h 2^k` up to the time at which errors lose their meaning; each is run once."""

    def __init__(self, scene: Scene) -> None:
        run = scene.run
        self.model, self.start = build(scene)
        self.stepper: Stepper = equal_steps(self.model, run, track_work=False)
        self.base = run.dt
        # on whole steps; number of times at which two neighbouring runs are compared to find the start of chaos
        grid = run.dt * max(1, int(run.duration / run.dt / 256))
        span, _ = trusted_span(self.model, self.start, run.duration, run.dt, grid, self.stepper)
        #: Time [s] up to which errors characterise the step.
        self.until = max(span, 2 * run.dt)
        self.links: dict[int, np.ndarray | None] = {}

    def dt(self, k: int) -> float:
        return self.base * 2.0**k

    def affordable(self, k: int) -> bool:
        # maximum number of halvings of the scene's step, and of steps of one pilot run
        return k >= -12 and self.until / self.dt(k - HALVINGS_BETWEEN) <= 100_000

    def sensible(self, k: int) -> bool:
        """At least 8 steps in the pilot."""
        return self.dt(k) <= self.until / 8

    def error(self, k: int) -> float:
        """Estimated error of the step `h 2^k` [rad], infinite if its run fails."""
        coarse, fine = self._run(k, k), self._run(k - HALVINGS_BETWEEN, k)
        if coarse is None or fine is None:
            return math.inf
        middle = self._run(k - 1, k)
        apart = rms_angle(coarse, fine)
        if middle is None or apart == 0:
            return apart
        # d(h, h/4) / d(h/2, h/4) = 1 + 2^p
        order = math.log2(max(apart / max(rms_angle(middle, fine), 1e-300) - 1, 1.5))
        return apart / (1 - 4.0 ** -min(order, 6.0))

    def _run(self, k: int, coarsest: int) -> np.ndarray | None:
        """Link vectors at up to 16 times to the end, on whole steps of the coarsest run compared with."""
        steps = max(1, int(self.until / self.dt(coarsest) + 1e-9))
        # maximum number of times at which pilot runs are compared; nearly always equal for steps h and h/2, so that
        # they share one compiled program
        stride = -(-steps // 16)  # rounded up: the saved times must reach the end, where errors are largest
        saves = steps // stride
        grid = stride * self.dt(coarsest)
        key = (k, coarsest)
        if key not in self.links:
            run = grid_run(self.stepper, self.model, self.start, grid, stride * 2 ** (coarsest - k), saves)
            times = grid * np.arange(1, saves + 1)
            good = status_of(run, self.stepper) == "ok"
            self.links[key] = link_vectors(self.model, run.r, times) if good else None
        return self.links[key]
