"""Freeing the parameters that cause a systematic error, one candidate at a time, while the log likelihood improves.

The first round is over separate windows, which remain solvable for any misfit. Isolated outliers switch on Student's
loss, and missing frames free a jump of the clock. Candidates from the score tests (`advice`) are tried. If several are
promising, each is fitted and their likelihoods decide, each with the noise that it leaves, minus `log(N)/2` per number.
Candidates within `INDISTINGUISHABLE_GAIN` of the best cannot be distinguished. They are reported together and the one
with fewest numbers is freed. The distance by which the others would move the estimates is added to the errors. The
second round uses the requested method, whose joined windows detect smaller faults, with score tests alone.

If the misfit is smooth, far above the noise, and not explained by any single candidate, the whole model is wrong. No
sample is then an outlier, and groups of numbers are freed by `group_trials`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dropper_jax.base.progress import Progress, silent
from fitting.calibration.advice import score_candidates
from fitting.calibration.clock_jumps import free_jumps
from fitting.calibration.freeing import MOST_FREED, Freeing, promising
from fitting.calibration.possible_faults import candidate_simulator, with_freed
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.windows.prepared import Prepared

#: One candidate may explain the poses at rest at the expense of the motion, so that no second one converges with it.
#: Correlated noise leaves a chi-square of up to 10.
REST_CHI_SQUARE = 20.0


def free_by_advice(
    prepared: Prepared,
    fit: Callable[..., Solution],
    method: str,
    loss: Loss = LEAST_SQUARES,
    simulator: Simulator | None = None,
    progress: Progress = silent,
) -> Freeing:
    """The fit with all beneficial candidates freed.

    Args:
        fit: an estimator, such as `estimate`.
        method: used for the last fits.
        simulator: must know the numbers of all candidates, such as that of an earlier call on the same scene.
    """
    simulator = simulator or candidate_simulator(prepared)
    prepared = with_freed(prepared, [], simulator)
    at = Freeing(prepared, fit(prepared, "windows", loss), loss, fit, simulator, progress)
    free_jumps(at)
    if at.is_wrong() and not at.free_one_fault():
        at.free_groups(method)
    wrong = at.is_wrong()
    first = len(at.freed)
    if not wrong:
        at.free_outliers()
    begin = replace(at, freed=list(at.freed))
    while not wrong and at.solution.status == "ok" and len(at.freed) - first < MOST_FREED:
        progress(0.5, f"testing what may be wrong, {len(at.freed)} freed")
        at.tested = score_candidates(at.prepared, at.solution, at.simulator)
        tries = promising(at.tested, at.refused)
        if not tries:
            break
        at.free_best(tries)
        at.free_outliers()
    if not wrong and at.is_wrong(REST_CHI_SQUARE):
        begin.free_groups(method)
        if len(begin.freed) > first:
            at = begin
    for candidate in at.freed[len(begin.freed) :]:
        at = at.reconsider(candidate)
    if method != "windows":
        at.continue_with(method)
    return at
