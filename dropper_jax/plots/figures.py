"""Energies and tensions against time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.analysis.spectrum import balance_drift
from dropper_jax.plots import moving, panels, style
from dropper_jax.plots.run import Run
from dropper_jax.plots.units import force_unit

#: Drift below this fraction of the maximum energy is rounding: the log axis ends there.
ROUNDING = 1e-17


@style.with_style
def energy_balance(run: Run, path: str | Path) -> Path:
    """Kinetic and potential energy (above its minimum), minus the work of each contribution, their sum, its drift [J].

    The sum is constant for an exact solution; below it, the absolute drift on a logarithmic axis.
    """
    t, kinetic, work = run.t, run.kinetic, run.work
    potential = run.potential - run.potential.min()
    figure = style.new_figure(8.5, 5.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    mark = {"marker": style.marker(t), "ms": 4}
    # The sum is drawn below the others: if there is only one energy, both stay visible.
    upper.plot(t, kinetic + potential - work.sum(axis=1), color=style.DARK, lw=2.4, label="sum", **mark)
    upper.plot(t, kinetic, color=style.CYCLE[0], lw=0.9, label="kinetic", **mark)
    upper.plot(t, potential, color=style.CYCLE[2], lw=0.9, label="potential, above its minimum", **mark)
    for index, name in enumerate(run.work_names):
        colour = style.CYCLE[1:2] + style.CYCLE[3:]
        upper.plot(t, -work[:, index], color=colour[index % len(colour)], label=f"minus work, {_words(name)}", **mark)
    upper.set_ylabel("energy [J]")
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)
    scale = max(np.abs(kinetic).max(), np.abs(potential).max()) or 1.0
    drift = np.maximum(np.abs(balance_drift(run)), ROUNDING * scale)
    lower.semilogy(t, drift, color=style.DARK, lw=0.8, **mark)
    lower.set_ylim(0.5 * drift[1:].min(initial=drift.max()), 3 * drift.max())
    lower.set_ylabel("|drift| [J]")
    style.time_axis(lower, t)
    style.title(figure, run, "energy balance")
    return style.save(figure, path)


@style.with_style
def tension_traces(run: Run, path: str | Path) -> Path:
    """Tension [N or kN] of every link against time (the mean over the step if the scheme gives it)."""
    unit, size = force_unit(run.tension)
    least = moving.TENSION * float(np.nanmax(np.abs(run.tension), initial=0.0)) / size
    columns = [(f"tension [{unit}]", run.tension / size)]
    return panels.traces(run, path, "link tensions", run.t_tension, columns, least)


def _words(name: str) -> str:
    return name.replace("_", " ")
