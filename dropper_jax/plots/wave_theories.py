"""The range of validity of the theories of regular waves, with marked waves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from dropper_jax.plots import figures, style
from dropper_jax.plots.style import ALERT, CYCLE, FAINT
from dropper_jax.sea.dispersion import wave_number
from dropper_jax.sea.steady import LINEAR_MAX_HARMONIC, STOKES_MAX_HEIGHT, STOKES_MAX_LENGTH, highest, second_harmonic


@style.plot_style()
def regimes(waves: Sequence[tuple[str, float, float, float]], gravity: float, path: str | Path) -> Path:
    """Areas of linear, Stokes V and stream function waves up to breaking.

    Lengths along the lines are those of linear waves; the theory of a wave is chosen by its own length.

    Args:
        waves: marked ones: label, height [m], period [s], depth [m].
    """
    marked = [
        (label, depth / (gravity * period**2), height / (gravity * period**2)) for label, height, period, depth in waves
    ]
    # drawn range of d/(g T^2), in which the marked waves are
    shallow = min([4e-4, *(0.5 * across for _, across, _ in marked)])
    deep = max([0.3, *(2.0 * across for _, across, _ in marked)])
    depths = np.geomspace(shallow, deep, 300)
    # of linear waves over g T^2
    length = 2.0 * np.pi / np.asarray(wave_number(jnp.full(depths.shape, 2.0 * np.pi), jnp.asarray(depths), 1.0))
    limit = np.vectorize(highest)(length, depths)
    linear = LINEAR_MAX_HARMONIC / np.vectorize(second_harmonic)(1.0, length, depths)
    stokes = np.where(length < STOKES_MAX_LENGTH * depths, STOKES_MAX_HEIGHT * limit, linear)
    figure = figures.new_figure(7.6, 6.2)
    axes = figure.subplots()
    low = min([1e-5, *(0.5 * up for _, _, up in marked)])
    high = max([0.05, *(2.0 * up for _, _, up in marked)])
    axes.fill_between(depths, low, linear, color=CYCLE[5], alpha=0.25, label="linear", lw=0)
    axes.fill_between(depths, linear, stokes, color=CYCLE[2], alpha=0.25, label="Stokes V", lw=0)
    axes.fill_between(depths, stokes, limit, color=CYCLE[4], alpha=0.3, label="stream function", lw=0)
    axes.plot(depths, limit, color=ALERT, lw=1.8, label="breaking (Williams 1981)")
    # depth over wavelength above which water is deep, and below which it is shallow
    for share, name in ((0.5, "deep"), (0.05, "shallow")):
        at = np.interp(share, depths / length, depths)
        axes.axvline(at, color=FAINT, lw=0.9, ls="--")
        text = f"d/L = {share:g}, {name}"
        axes.annotate(text, (at, 0.03), (4, 0), ("data", "axes fraction"), "offset points", fontsize=8, rotation=90)
    for i, (label, across, up) in enumerate(marked):
        axes.plot(across, up, "o", color=CYCLE[1 - i % 2], ms=8, label=label, zorder=5)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="depth d/(g T²)",
        ylabel="height H/(g T²)",
        xlim=(depths[0], depths[-1]),
        ylim=(low, high),
    )
    figure.legend(loc="outside lower center", ncols=3)
    figures.title(figure, "theories of regular waves")
    return figures.save(figure, path)
