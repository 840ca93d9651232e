"""Tornado pictures of sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropper_jax.plots import figures, style
from fitting.sensitivity.global_indices import GlobalIndices
from fitting.sensitivity.result import LocalDerivatives

#: Of bars with a positive value, for each of the values.
COLOURS = (style.CYCLE[0], style.CYCLE[5])


def local_picture(found: LocalDerivatives, path: str | Path) -> Path:
    """Scaled derivatives as bars, the largest on top, without those that are not resolved."""
    values = found.scaled
    errors = found.scaled_error
    label = "change of the quantity for 1 % of the parameter [%]"
    shown = np.flatnonzero(found.resolved)
    if not np.isfinite(values[shown]).all():
        values = found.forward
        errors = found.error
        label = "dQ/dp"
    note = f"whole run of {found.duration:g} s"
    if found.window is not None:
        note = f"NOT valid beyond {found.horizon:.2g} s"
    title = f"{found.of} = {found.value:.4g} {found.unit}; {note}"
    if errors is None:
        errors = np.full(len(values), np.nan)
    names = [found.names[i] for i in shown]
    return _bars(names, [values[shown]], [""], label, title, path, [errors[shown]])


def global_picture(found: GlobalIndices, of: str, path: str | Path) -> Path:
    """Sobol's first and total indices, or Morris' mean and spread, as bars."""
    labels = ["mean |effect|", "spread"]
    axis = "effect over the whole range [unit of the quantity]"
    if found.method == "sobol":
        labels = ["alone", "with interactions"]
        axis = "fraction of the variance [-]"
    errors = [found.first_error, found.total_error]
    return _bars(found.names, [found.first, found.total], labels, axis, f"{of}: {found.runs} runs", path, errors)


def path_label(name: str) -> str:
    """A parameter's path as a label: "mass of link 3" for `line.0.mass.2`, "linear damping: b_l"."""
    section, *words = name.split(".")
    if section == "effects":
        return f"{words[0].replace('_', ' ')}: {'.'.join(words[1:])}"
    if section != "line" or len(words) < 2 or not words[-1].isdigit():
        return name
    line = "" if words[0] == "0" else f"line.{words[0]}: "
    return f"{line}{words[1]} of link {int(words[-1]) + 1}"


@style.plot_style()
def _bars(
    names: Sequence[str],
    values: Sequence[np.ndarray],
    labels: Sequence[str],
    axis: str,
    title: str,
    path: str | Path,
    errors: Sequence[np.ndarray],
) -> Path:
    """Horizontal bars of the names, the largest on top, side by side for several `values`, each with its label."""
    order = np.argsort(np.abs(values[0]))
    figure = figures.new_figure(8.0, 1.4 + 0.42 * len(names))
    axes = figure.subplots()
    height = 0.8 / len(values)
    for i, (column, label) in enumerate(zip(values, labels, strict=True)):
        row = np.arange(len(names)) + (0.5 * (len(values) - 1) - i) * height
        colour = np.where(column[order] < 0, style.SECOND, COLOURS[i])
        spread = errors[i][order] if np.isfinite(errors[i]).all() else None
        axes.barh(row, column[order], height, color=colour, label=label, xerr=spread, ecolor=style.DARK)
    axes.set_yticks(np.arange(len(names)), [path_label(names[i]) for i in order])
    axes.axvline(0.0, color=style.DARK, lw=0.8)
    axes.set_xlabel(axis)
    axes.set_title(title, loc="left")
    axes.grid(axis="y", visible=False)
    if len(values) > 1:
        axes.legend(loc="lower right")
    return figures.save(figure, path)
