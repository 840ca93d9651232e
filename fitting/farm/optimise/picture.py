"""A picture of a design: the layout from the side, and the utilisation of constraints, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots.style import DARK, FAINT, FIRST, SECOND, new_figure, plot_style
from dropper_jax.plots.style import save as save_figure
from fitting.farm.optimise.models import still_model
from fitting.farm.optimise.run import Optimum
from fitting.farm.optimise.values import near_rest
from fitting.farm.site import Site


@plot_style()
def design_picture(site: Site, found: Optimum, file: Path) -> Path:
    """Write the picture."""
    figure = new_figure(10.0, 7.4)
    above, below = figure.subplots(2, 1, height_ratios=(1.2, 1.0))
    storm = site.cases[0].storm
    for values, colour, label in ((found.before, FAINT, "before"), (found.after, FIRST, "after")):
        model = still_model(site, found.variables, np.asarray(values), storm)
        s = near_rest(model, None)
        nodes = np.asarray(model.nodes(s.r, model.ends(s.t)))
        begin = 0
        for member in model.geometry.members:
            own = nodes[begin : begin + member.links + 1]
            above.plot(own[:, 0], own[:, 2], color=colour, linewidth=1.0, label=label if begin == 0 else None)
            begin += member.links + 1
    above.axhline(storm.level, color=SECOND, linewidth=0.8)
    above.axhline(-site.sea.depth, color=DARK, linewidth=0.8)
    above.set(xlabel="x [m], not to the scale of z", ylabel="z [m]", title=f"{site.name} at rest, {storm.name}")
    above.margins(y=0.08)
    above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    rows = sorted(found.constraints.items(), key=lambda item: -max(item[1]))[:14][::-1]
    row = np.arange(len(rows))
    below.barh(row + 0.2, [row[1][0] for row in rows], 0.38, color=FAINT, label="before")
    below.barh(row - 0.2, [row[1][1] for row in rows], 0.38, color=FIRST, label="after")
    below.axvline(1.0, color=SECOND, linewidth=1.0)
    below.set_yticks(row, [row[0] for row in rows], fontsize=7)
    below.set(xlabel="utilisation (limit 1)")
    below.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return save_figure(figure, file)
