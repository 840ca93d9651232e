"""One uninterrupted run over a measured trace, as in the thesis' Figures 8.20 and 8.27, and how far to trust it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots import style
from fitting.calibration.one_run import OneRun
from fitting.report.pictures import MOST


@style.look()
def one_run_picture(found: OneRun, name: str, path: Path) -> Path:
    """Measured angles and the run, per link [rad from the horizontal]; faint where it is not to be trusted."""
    links = min(found.measured.shape[1], MOST)
    figure = style.new_figure(9.0, 1.5 + 1.3 * links)
    axes = figure.subplots(links, 1, sharex=True, squeeze=False)[:, 0]
    more = f" (links 1 to {links} of {found.measured.shape[1]})" if found.measured.shape[1] > links else ""
    title = f"{name}: one run over the trace{more} [rad from the horizontal]"
    figure.suptitle(title, fontsize=12, fontweight="bold", x=0.01, ha="left")
    good = found.t <= found.trusted
    # one turn is chosen where the run is right, so that a whole one apart is no difference
    shift = (
        2 * np.pi * np.round(np.nan_to_num(np.nanmedian((found.measured - found.simulated)[good], axis=0)) / 2 / np.pi)
    )
    simulated = found.simulated + shift
    for j in range(links):
        axes[j].plot(found.t, found.measured[:, j], ".", ms=1.2, color=style.DARK, label="measured")
        axes[j].plot(found.t[good], simulated[good, j], lw=1.4, color=style.FIRST, label="one run")
        if not good.all():
            axes[j].plot(
                found.t[~good], simulated[~good, j], lw=0.8, color=style.FIRST, alpha=0.55, label="beyond trust"
            )
            axes[j].axvline(found.trusted, color=style.SECOND, lw=1.0, ls="--")
        axes[j].set_ylabel(f"link {j + 1}")
    axes[0].legend(loc="upper right", ncols=3, markerscale=4)
    style.time_axis(axes[-1], found.t)
    return style.save(figure, path)
