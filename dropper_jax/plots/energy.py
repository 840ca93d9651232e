"""Energies over time, and the drift of their balance."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from dropper_jax.analysis.energy import balance_drift
from dropper_jax.plots import figures, marks, scales, style
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import CYCLE, DARK

#: Drift below this fraction of the maximum energy is rounding: the log axis ends there.
ROUNDING = 1e-17


@style.with_style
def energy_balance(run: Run, path: str | Path) -> Path:
    """Kinetic and potential energy (above its minimum), minus the work of each contribution, their sum, its drift [J].

    The sum is constant for an exact solution; below it, the absolute drift on a logarithmic axis.
    """
    t = run.t
    kinetic = run.kinetic
    work = run.work
    potential = run.potential - run.potential.min()
    figure = figures.new_figure(8.5, 5.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    mark = {"marker": marks.marker(t), "ms": 4}
    # The sum is drawn below the others: if there is only one energy, both stay visible.
    upper.plot(t, kinetic + potential - work.sum(axis=1), color=DARK, lw=2.4, label="sum", **mark)
    upper.plot(t, kinetic, color=CYCLE[0], lw=0.9, label="kinetic", **mark)
    upper.plot(t, potential, color=CYCLE[2], lw=0.9, label="potential, above its minimum", **mark)
    colours = itertools.cycle(CYCLE[1:2] + CYCLE[3:])
    for name, done, colour in zip(run.work_names, work.T, colours, strict=False):
        upper.plot(t, -done, color=colour, label=f"minus work, {name.replace('_', ' ')}", **mark)
    upper.set_ylabel("energy [J]")
    figures.legend_above(upper, 3, "left", borderaxespad=0.2)
    scale = max(np.abs(kinetic).max(), np.abs(potential).max()) or 1.0
    drift = np.maximum(np.abs(balance_drift(run)), ROUNDING * scale)
    lower.semilogy(t, drift, color=DARK, lw=0.8, **mark)
    lower.set_ylim(0.5 * drift[1:].min(initial=drift.max()), 3 * drift.max())
    lower.set_ylabel("|drift| [J]")
    scales.time_axis(lower, t)
    return figures.finish(figure, run, "energy balance", path)
