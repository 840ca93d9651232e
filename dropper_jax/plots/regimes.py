"""Range of validity of the wave theories over depth and height by the period (after Le Mehaute 1976), with waves
marked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from dropper_jax.plots import style
from dropper_jax.sea.spectrum import wave_number
from dropper_jax.sea.steady import LINEAR, STOKES_HEIGHT, STOKES_LENGTH, highest, second_harmonic

#: Drawn range of d/(g T^2).
DEPTHS = np.geomspace(4e-4, 0.3, 300)
#: Depth over wavelength above which water is deep, and below which it is shallow.
DEEP, SHALLOW = 0.5, 0.05


@style.plot_style()
def regimes(waves: Sequence[tuple[str, float, float, float]], gravity: float, path: str | Path) -> Path:
    """Areas of linear, Stokes V and stream function waves up to breaking.

    Lengths along the lines are those of linear waves; the theory of a wave is chosen by its own length.

    Args:
        waves: marked ones: label, height [m], period [s], depth [m].
    """
    length = _length(DEPTHS)
    limit = np.array([highest(x, d) for x, d in zip(length, DEPTHS, strict=True)])
    linear = np.array([LINEAR / second_harmonic(1.0, x, d) for x, d in zip(length, DEPTHS, strict=True)])
    stokes = np.where(length < STOKES_LENGTH * DEPTHS, STOKES_HEIGHT * limit, linear)
    figure = style.new_figure(7.6, 6.2)
    axes = figure.subplots()
    low = min([1e-5, *(0.5 * h / (gravity * t**2) for _, h, t, _ in waves)])
    axes.fill_between(DEPTHS, low, linear, color=style.CYCLE[5], alpha=0.25, label="linear", lw=0)
    axes.fill_between(DEPTHS, linear, stokes, color=style.CYCLE[2], alpha=0.25, label="Stokes V", lw=0)
    axes.fill_between(DEPTHS, stokes, limit, color=style.CYCLE[4], alpha=0.3, label="stream function", lw=0)
    axes.plot(DEPTHS, limit, color=style.ALERT, lw=1.8, label="breaking (Williams 1981)")
    for share, name in ((DEEP, "deep"), (SHALLOW, "shallow")):
        _line(axes, float(np.interp(-share, -DEPTHS[::-1] / length[::-1], DEPTHS[::-1])), f"d/L = {share:g}, {name}")
    for i, (label, height, period, depth) in enumerate(waves):
        scale = gravity * period**2
        axes.plot(depth / scale, height / scale, "o", color=style.CYCLE[1 - i % 2], ms=8, label=label, zorder=5)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="depth d/(g T²)",
        ylabel="height H/(g T²)",
        xlim=(DEPTHS[0], DEPTHS[-1]),
        ylim=(low, 0.05),
    )
    figure.legend(loc="outside lower center", ncols=3)
    figure.suptitle("theories of regular waves", fontsize=12, fontweight="bold", x=0.01, ha="left")
    return style.save(figure, path)


def _length(depth: np.ndarray) -> np.ndarray:
    """Length of linear waves over g T^2."""
    return 2.0 * np.pi / np.asarray(wave_number(jnp.full(depth.shape, 2.0 * np.pi), jnp.asarray(depth), 1.0))


def _line(axes: Axes, at: float, text: str) -> None:
    axes.axvline(at, color=style.FAINT, lw=0.9, ls="--")
    axes.annotate(text, (at, 0.03), (4, 0), ("data", "axes fraction"), "offset points", fontsize=8, rotation=90)
