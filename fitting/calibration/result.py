"""The result of a fit: numbers with errors, predictions of stretches that it has not used, and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dropper_jax.base.json_values import jsonable
from dropper_jax.model import Model
from fitting.calibration.candidate import Candidate
from fitting.calibration.disagreement import Disagreement
from fitting.calibration.held_out import HeldOut
from fitting.estimate.noise import Noise, mean_by_run
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.scene_fit import SceneFit
from fitting.estimate.shooting import GAP_WEIGHTS
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import chance_below, degrees_of_freedom
from fitting.estimate.window_problem import Problem
from fitting.estimate.windows import Span, Windows
from fitting.laws.decision import verdict
from fitting.laws.law_tests import LawTest, LawTests, freeing_option
from fitting.laws.laws import DRAG_PATHS, Law
from fitting.traces.conventions import MAX_GAP_PERIODS
from fitting.traces.planar import pendulum_period
from fitting.traces.trace import Trace
from fitting.windows.prepared import Prepared


def direction_text(direction: Mapping[str, float]) -> str:
    """A direction of parameters in words."""
    return ", ".join(f"{share:+.2g} {name}" for name, share in direction.items())


def chi2_per_dof(prepared: Prepared, solution: Solution) -> float:
    """Chi-square per degree of freedom of a fit, relative to the noise that the traces claim."""
    residual = solution.errors * prepared.windows.weight
    return float(np.sum(solution.weights * residual**2)) / degrees_of_freedom(solution)


#: chi-square per degree of freedom, and correlation of neighbouring residuals, above which a fit misses its trace.
MISFIT_CHI_SQUARE = 2.0
MISFIT_CORRELATION = 0.1
#: Gap weight from which windows whose noise keeps a memory join loosely: those of wrong laws reach 0.03 to 1.
LOOSE_JOIN = 0.03
#: Probability, of a value on its bound, that the optimum without bounds lies this far beyond it by chance.
BOUND_CHANCE = 1e-3
#: Maximum fraction of the samples that may be left out of a fit with status `ok`.
MOST_LEFT_OUT = 0.03
#: Noise [rad] far below an encoder's, as only simulated traces have.
SIMULATED_NOISE = 5e-6
#: Number of candidates of `advise` that are listed in the warnings.
NAMED_CANDIDATES = 3
#: Statuses that `--accept-misfit` accepts.
ACCEPTABLE = ("misfit", "model_error")


@dataclass(frozen=True)
class Combination:
    """`b_l + speed_m_per_s b_q`: the paths `of` both, its value and standard error."""

    of: tuple[str, str]
    speed_m_per_s: float
    value: float
    std_error: float
    unit: str = "kg/s"


@dataclass(kw_only=True)
class FitResult(SceneFit[Problem, Evaluation]):
    """A calibrated model: the content of every fit (`SceneFit`), and that of windows of traces.

    Attributes:
        noise: estimated standard deviation of the noise [rad].
        chi2_per_dof: relative to the noise that the traces (or their standard errors) claim.
        held_out: error on stretches that were not fitted.
        comparison: rows of the model comparison, or empty.
        seconds: compile and run time.
        advice: what else may be wrong, if requested, the largest gain first.
        freed: candidates that were freed for their gain, in order.
        left_out: (run, from, to) [s] of windows that were not fitted because no start explains them.
        wrong_file: the mistake in the traces that explains a misfit, in a line; otherwise empty.
        likely: the likeliest cause of a smaller misfit and what to free, from the score tests; otherwise empty.
        laws: score tests of forces that the scene lacks.
        recordings: of one motion, where each of them disagrees; otherwise empty.
        prepared: what was fitted; `advise`, `compare` and others start from it.
        tested: score tests that were made because of a misfit.
        accepted: whether a misfit or a wrong law is accepted; it has errors then.
    """

    method: str
    noise: float
    chi2_per_dof: float
    seconds: dict[str, float]
    traces: list[Trace]
    lyapunov: float
    held_out: list[HeldOut] = field(default_factory=list)
    comparison: list[Law] = field(default_factory=list)
    advice: list[Candidate] = field(default_factory=list)
    freed: list[Candidate | LawTest] = field(default_factory=list)
    wrong_file: str = ""
    likely: str = ""
    left_out: tuple[Span, ...] = ()
    laws: LawTests = LawTests()
    recordings: list[Disagreement] = field(default_factory=list)
    prepared: Prepared
    tested: list[Candidate] = field(default_factory=list)
    accepted: bool = False

    @property
    def has_errors(self) -> bool:
        """Whether the parameters have errors: not those of a failed fit, unless its misfit is accepted."""
        return self.status == "ok" or (self.accepted and self.status in ACCEPTABLE)

    @property
    def status(self) -> str:
        """`ok`, `not_converged`, `lost_windows`, `model_error` or `misfit`; `message` gives the reason.

        `lost_windows`: more than `MOST_LEFT_OUT` of the samples are in windows that no start explains. `model_error`:
        the traces show a force that the scene lacks, which changes a reported value (`laws`). `misfit`: the residuals
        exceed the noise and the stated model error, and are not noise because neighbours correlate or because the
        windows do not join, or a bound excludes the value that fits best.
        """
        if self.solution.status != "ok":
            return self.solution.status
        if self.left_out_share > MOST_LEFT_OUT:
            return "lost_windows"
        if self.laws.wrong is not None and not self.wrong_file:
            return "model_error"
        if self.wrong_file or self.misses or self.excluded:
            return "misfit"
        return "ok"

    @property
    def excluded(self) -> list[int]:
        """Numbers of the parameters whose bound excludes the value that fits best, which chance does not explain."""
        u = self.uncertainty
        return [i for i in np.flatnonzero(u.at_bound) if chance_below(-u.beyond_bound[i], u.blocks) < BOUND_CHANCE]

    @property
    def misses(self) -> bool:
        """Whether the model misses the trace by more than noise of any kind explains.

        Noise with a memory, or jitter, explains any residuals inside the windows, but not that windows do not join.
        """
        if self.has_unexplained_joins:
            return True
        noise = self.solution.problem.noise
        if noise is not None and noise.kind != "white":
            return self.chi2_per_dof > MISFIT_CHI_SQUARE and not self.windows_join
        return self.chi2_per_dof > MISFIT_CHI_SQUARE and abs(self.uncertainty.correlation_1[0]) > MISFIT_CORRELATION

    @property
    def has_unexplained_joins(self) -> bool:
        """Whether windows join as loosely as those of wrong laws do, where the noise has a memory or a force is shown.

        Noise with a memory does not loosen joins: 20 such fits of right models have gap weights of at most 0.001. A
        force that is shown may change no value by much, and yet not be what is wrong. Of 615 fits (355 of right models,
        260 whose faults were freed), two join as loosely, and neither shows a force.
        """
        gap_weight = self.solution.gap_weight
        if gap_weight is None or gap_weight < LOOSE_JOIN:
            return False
        noise = self.solution.problem.noise
        return (noise is not None and noise.kind != "white") or bool(self.laws.significant)

    @property
    def windows_join(self) -> bool:
        """Whether a start of a window may be closer to the end of the previous one than 0.1 rad and 1 rad/s.

        True of separate windows, of which nothing is known. Of 520 fits of right models, with any noise, all join.
        """
        return self.solution.gap_weight is None or self.solution.gap_weight < GAP_WEIGHTS[0]

    @property
    def left_out_share(self) -> float:
        """Fraction of the samples in windows that were left out."""
        removed = 0
        for run, low, high in self.left_out:
            removed += int(np.isfinite(self.traces[run].between(low, high).theta).sum())
        return removed / max(removed + self.windows.samples, 1)

    @property
    def message(self) -> str:
        """The reason of a status that is not `ok`."""
        found = [self.wrong_file, self.solution.message]
        if self.status == "lost_windows":
            found.append(
                f"{self.left_out_share:.1%} of the samples lie in windows that no start explains. "
                "Try a finer --dt or a shorter --window, or cut these stretches out"
            )
        wrong = self.laws.wrong
        if self.status == "model_error" and wrong is not None:
            names = self.solution.problem.names
            found.append(f"the law is wrong: the trace shows {freeing_option(wrong, names)}")
        if self.status in ACCEPTABLE and not self.wrong_file:
            found += [self._advice_on_bound(i) for i in self.excluded]
        if self.status == "misfit" and self.misses and not self.wrong_file:
            reason = f"neighbours correlate by {self.uncertainty.correlation_1[0]:.2f}"
            if self.has_unexplained_joins or not self.windows_join:
                reason = "the windows of the fit do not join to one motion"
            times = np.sqrt(self.chi2_per_dof)
            found.append(
                f"the residuals are {times:.3g} times the noise and {reason}: the model misses the trace. "
                f"{self._advice_on_misfit(self.rms / times)}"
            )
        return "; ".join(filter(None, found))

    def _advice_on_bound(self, i: int) -> str:
        """What to do about a parameter (its number) whose bound excludes the value that fits best."""
        advice = "Widen the bound (--bounds), or find what else is wrong (--advice)"
        if self.values[i] == 0:
            advice = "It cannot be negative: find what else is wrong (--advice)"
        return (
            f"{self.parameters[i].name} is held at its bound {self.values[i]:g}, "
            f"{self.uncertainty.beyond_bound[i]:.2g} standard errors from the value that fits best. {advice}"
        )

    def _advice_on_misfit(self, noise: float) -> str:
        """What to do about residuals that exceed the claimed noise [rad]."""
        if noise < SIMULATED_NOISE:
            return (
                f"The trace has hardly any noise ({noise:.1g} rad), as a simulated one: the residuals, {self.rms:.1g} "
                "rad RMS, are then errors of two time steps or schemes. State them as model_error, as the tables of "
                "`dropper run` do, add a camera's noise (fitting.traces.synthetic.observe) or accept it by "
                "--accept-misfit"
            )
        if self.recordings:
            return "Fit each recording alone to find the one that differs; leave out --same-motion for separate runs"
        if self.likely:
            return f"Likeliest cause: {self.likely}, or state a model_error in [fit]"
        return "Try --auto-free, state a model_error in [fit], or accept it by --accept-misfit"

    @property
    def windows(self) -> Windows:
        """The fitted windows."""
        return self.solution.windows

    @property
    def rms(self) -> float:
        """RMS angle error of the windows [rad]."""
        return self.solution.rms

    @property
    def descent(self) -> list[dict[str, Any]]:
        """Loss per sample, parameters and gap weight of every step of the method `gradient`; otherwise empty."""
        points = []
        if self.method == "gradient":
            points = self.solution.history
        return [{"loss": one.loss, "values": one.values, "gap_weight": one.gap_weight} for one in points]

    @property
    def model(self) -> Model:
        """The calibrated model."""
        return self.solution.problem.simulator.model_at(self.values)

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON; values that are not finite become null."""
        found: dict[str, Any] = {
            "rms_rad": self.rms,
            "held_out_rms_rad": [h.rms for h in self.held_out],
            "chi2_per_dof": self.chi2_per_dof,
            "noise_rad": self.noise,
            "window_s": self.windows.length,
            "shortest_window_s": float(self.windows.lengths.min()),
            "gap_weight": self.solution.gap_weight,
            "lyapunov_per_s": self.lyapunov,
            "laws": self.laws.tests,
            "noise": self.noise_table(),
        }
        if self.advice or self.freed:
            found |= {"advice": self.advice, "freed": self.freed}
        left_out = []
        for run, low, high in self.left_out:
            left_out.append({"trace": self.traces[run].name, "from_s": low, "to_s": high})
        requested = {
            "descent": self.descent,
            "comparison": self.comparison,
            "recordings": self.recordings,
            "law": self.comparison and verdict(self.comparison),
            "left_out": left_out,
        }
        if self.has_errors:
            requested["best_determined"] = self.best_combination
        common = self.common_json(self.method, self.windows.dt / self.windows.substeps)
        return jsonable(common | found | {key: value for key, value in requested.items() if value})

    @property
    def fastest(self) -> float:
        """Limit of the speeds [m/s] of nodes in the traces: the maximum sum of the links' lengths times their rates."""
        length = np.asarray(self.solution.problem.simulator.model_at(self.values).line.length)
        fastest = 0.0
        for trace in self.traces:
            theta = trace.across_gaps(MAX_GAP_PERIODS * pendulum_period(length))
            rates = np.abs(np.diff(theta, axis=0)) / np.diff(trace.t)[:, None]
            fastest = max(fastest, np.max(np.nansum(rates * length, axis=1), initial=0.0))
        return fastest

    @property
    def best_combination(self) -> Combination | None:
        """`b_l + v b_q` with the speed v [m/s] at which the trace determines it best, its value and standard error.

        Linear and quadratic damping have similar effects at the speed of the motion, so that each alone is much less
        certain. With covariance C, `v = -C_lq/C_qq` has the minimum variance. None if no node moves at that speed: the
        combination would have no meaning.
        """
        names = self.solution.problem.names
        mine = [names.index(name) for name in DRAG_PATHS if name in names]
        C = self.uncertainty.covariance[np.ix_(mine, mine)]
        if len(mine) < 2 or not (np.diag(C) > 0).all():
            return None
        speed = -C[0, 1] / C[1, 1]
        if not 0.0 < speed <= self.fastest:
            return None
        value = self.values[mine[0]] + speed * self.values[mine[1]]
        return Combination(DRAG_PATHS, speed, value, np.sqrt(max(C[0, 0] + speed * C[0, 1], 0.0)))

    def note(self, i: int) -> str:
        """Remarks on parameter i."""
        return ", ".join(filter(None, [super().note(i), self.laws.remark(self.parameters[i].name)]))

    def estimates(self) -> dict[str, dict[str, Any]]:
        """As those of every fit, with remarks on values that are not those of one force."""
        found = super().estimates()
        for name, estimate in found.items():
            if remark := self.laws.remark(name):
                estimate["remark"] = remark
        return found

    def add_advice(self, candidates: list[Candidate]) -> None:
        """Report candidates of `advise`, the first ones worth it as warnings too."""
        self.advice = candidates
        self.warnings += [str(candidate) for candidate in candidates if candidate.worth_naming][:NAMED_CANDIDATES]

    def noise_table(self) -> dict[str, Any]:
        """The noise estimated from the residuals: its kind, and by run and link its size, memory and delay.

        `kept` is the fraction of its noise that a sample passes to the next one.
        """
        windows = self.windows
        known = windows.known
        square = mean_by_run(1 / np.where(known, windows.weight, 1.0) ** 2, windows, len(self.traces))
        noise = self.solution.problem.noise or Noise.as_claimed(*square.shape)
        found: dict[str, Any] = {"kind": noise.kind, "sigma_rad": np.sqrt(square)}
        if noise.kind == "correlated":
            interval = np.array([trace.interval for trace in self.traces])[:, None]
            found["kept"] = np.exp(-noise.decay * interval)
        if noise.kind == "jitter":
            found["delay_s"] = noise.delay
        return found
