"""Quality checks of a run: its energy balance, unresolved axial vibrations, faults of tensions, rounded times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.run.samples import DRIFT, TOO_LONG, Kind, Samples
from dropper_jax.run.tension_faults import tension_warnings
from dropper_jax.run.winches import winch_warnings

#: Energy balance error, as a fraction of the energy scale, above which the status of a run is not ok.
ENERGY_ERROR = 0.1
#: Energy error [J] per weight times length of all lines that is ignored: rounding of runs at rest. The weight is that
#: of standard gravity also in scenes without gravity, whose prestressed lines have rounding too.
RESTING_ERROR = 1e-6
#: Energy of unresolved axial vibrations, as a fraction of all dissipated work and of the energy scale, above which it
#: is warned of: on a mass that bounces on a rope peaks and deviations are then 2 % too low ...
RINGING_WARNED = 0.1
#: ... and above which the steps are too long: they are then 10 % too low.
RINGING_UNUSABLE = 0.5
#: Rounding of the times of a run over its step above which it is warned of.
CLOCK_ERROR = 1e-3
#: First words of the warning of the energy balance.
BALANCE_ERROR = "energy balance error"


def with_quality_checks(solution: Kind) -> Kind:
    """The solution with the warnings of its quality checks; its status is not ok if the energy balance has a large
    error, or if most of the dissipated work is that of axial vibrations which the steps do not resolve."""
    line = solution.scene.line
    negligible = RESTING_ERROR * GRAVITY * float(np.sum(line.mass)) * float(np.sum(line.length))
    scale = max(solution.energy_scale, negligible)
    faults = [*tension_warnings(solution), *winch_warnings(solution), *_clock_warnings(solution)]
    status = solution.status
    warnings = list(solution.warnings)
    for verdict, found in (_check_balance(solution, scale), ("ok", faults), _check_ringing(solution, scale)):
        if status == "ok":
            status = verdict
        warnings += found
    return replace(solution, status=status, warnings=tuple(warnings))


def _clock_warnings(solution: Samples) -> Iterator[str]:
    """A warning if the times of a run, sums of its steps, are rounded so coarsely that they drift."""
    used = solution.settings
    step = used["dt"]
    if "refused_steps" in used:  # with an accuracy dt is the interval between saved times
        step = float(solution.t[-1] - solution.t[0]) / max(used["steps"], 1)
    end = float(solution.t[-1])
    rounding = float(np.spacing(np.asarray(end, used["dtype"])))
    if 0.0 < CLOCK_ERROR * step < 0.5 * rounding:  # no step: the first one failed
        yield (
            f"run.dtype: {used['dtype']} rounds times near {end:.4g} s to {rounding:.2g} s: sums of steps of "
            f"{step:.2g} s drift by up to {0.5 * rounding / step:.1%}. Use float64"
        )


def _check_balance(solution: Samples, scale: float) -> tuple[str, list[str]]:
    """Status and warnings by the error of the energy balance, against the energy scale [J]."""
    drift = solution.energy_drift
    if not (solution.settings.get("track_work", True) and drift > ENERGY_ERROR * scale):
        return "ok", []
    warnings = [f"{BALANCE_ERROR} {drift:.3g} J (reference {scale:.3g} J). Use a smaller step"]
    # a scheme with numerical damping (implicit Euler: 90 % of a lab dropper's energy) warns; it fails if it gains
    # as much, from any time to a later one, or loses more than the energy scale
    gain = np.max(solution.balance - np.minimum.accumulate(solution.balance))
    if _dissipates(solution) and max(drift, gain / ENERGY_ERROR) <= scale:
        return "ok", warnings
    return DRIFT, warnings


def _check_ringing(solution: Samples, scale: float) -> tuple[str, list[str]]:
    """Status and warnings by the energy of unresolved axial vibrations, against the energy scale [J]."""
    share = solution.axial_ringing_share
    ringing = min(share, solution.axial_ringing / scale)
    if ringing <= RINGING_WARNED:
        return "ok", []
    warning = (
        f"axial vibrations that the steps do not resolve take {share:.0%} of the dissipated work: peaks and "
        "deviations of tensions are too low. Use a smaller --accuracy or --dt, or line.axial.damping"
    )
    if ringing > RINGING_UNUSABLE:
        return TOO_LONG, [warning]
    return "ok", [warning]


def _dissipates(solution: Samples) -> bool:
    """Whether the scheme of a run has numerical damping."""
    scheme = INTEGRATORS[solution.settings["integrator"]]
    return scheme(**{name: solution.settings[name] for name in scheme.options()}).dissipates
