"""A picture of a design: the layout from the side, and the utilisation of constraints, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots.figures import new_figure
from dropper_jax.plots.figures import save as save_figure
from dropper_jax.plots.style import DARK, FAINT, FIRST, SECOND, plot_style
from fitting.farm.optimise.calm_model import build_calm_model
from fitting.farm.optimise.equilibria import find_equilibrium
from fitting.farm.optimise.optimum import Optimum
from fitting.farm.site import Site

#: Maximum number of constraints that are drawn.
MAX_BARS = 14


@plot_style()
def draw_design(site: Site, found: Optimum, file: Path) -> Path:
    """Write the picture, with at most `MAX_BARS` constraints, the most used ones."""
    figure = new_figure(10.0, 7.4)
    above, below = figure.subplots(2, 1, height_ratios=(1.2, 1.0))
    storm = site.cases[0].storm
    rows = sorted(found.constraints.items(), key=lambda item: -max(item[1]))[:MAX_BARS][::-1]
    row = np.arange(len(rows))
    used = np.reshape([both for _, both in rows], (-1, 2)).T
    designs = (("before", found.before, FAINT, 0.2), ("after", found.after, FIRST, -0.2))
    for i, (label, values, colour, shift) in enumerate(designs):
        model = build_calm_model(site, found.variables, values, storm)
        s = find_equilibrium(model, None)
        nodes = np.asarray(model.nodes(s.r, model.ends(s.t)))
        counts = [member.links + 1 for member in model.geometry.members]
        for k, line in enumerate(np.split(nodes, np.cumsum(counts)[:-1])):
            name = label if k == 0 else None  # once in the legend
            above.plot(line[:, 0], line[:, 2], color=colour, linewidth=1.0, label=name)
        below.barh(row + shift, used[i], 0.38, color=colour, label=label)
    above.axhline(storm.level, color=SECOND, linewidth=0.8)
    above.axhline(-site.sea.depth, color=DARK, linewidth=0.8)
    above.set(xlabel="x [m], not to the scale of z", ylabel="z [m]", title=f"{site.name} at rest, {storm.name}")
    above.margins(y=0.08)
    above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    below.axvline(1.0, color=SECOND, linewidth=1.0)
    below.set_yticks(row, [name for name, _ in rows], fontsize=7)
    below.set(xlabel="utilisation (limit 1)")
    below.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return save_figure(figure, file)
