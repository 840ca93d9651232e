"""Picture of load cases: utilisation of every part and anchor over the cases, the worst with its error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.plots import style

#: Bars of parts that hold and of those that do not, and dots of cases with whole and with broken lines.
HOLDS, WEAK = "#C9DAEA", "#F0C9B0"
INTACT, BROKEN = style.CYCLE[0], style.CYCLE[1]


@style.look()
def draw_utilisation(found: dict[str, Any], path: Path) -> Path:
    """A row for each part and each held point that an anchor holds: dots are cases, bars reach to the worst one."""
    rows = [(part["part"], part["cases"], part["worst"], part["step"]) for part in found["parts"]]
    rows += [(f"anchor {a['point']}", a["cases"], a["worst"], None) for a in found["anchors"] if a["anchor"]]
    rows = [row for row in rows if row[2] is not None]
    figure = style.new_figure(7.5, 1.5 + 0.34 * max(len(rows), 1))
    axes = figure.subplots()
    states = {case["case"]: case["state"] for case in found["cases"]}
    for i, (_, cases, worst, step) in enumerate(rows):
        y = len(rows) - 1 - i
        weak = worst["utilisation"] > 1.0
        axes.barh(y, worst["utilisation"], height=0.55, color=WEAK if weak else HOLDS, zorder=1)
        share = 0.0 if step is None else step.get("relative", 0.0)
        error = np.hypot(worst["utilisation_error"] or 0.0, share * worst["utilisation"])
        axes.errorbar(worst["utilisation"], y, xerr=error, color=style.DARK, capsize=3, lw=1, zorder=4)
        for broken, colour in ((False, INTACT), (True, BROKEN)):
            used = [c["utilisation"] for c in cases if (states[c["case"]] != "intact") == broken]
            label = ("a line breaks" if broken else "intact") if i == 0 else None
            axes.plot(used, np.full(len(used), y), "o", ms=3.5, color=colour, zorder=3, label=label)
    axes.axvline(1.0, color=style.ALERT, lw=1, ls="--")
    axes.set_yticks(range(len(rows)), [row[0] for row in reversed(rows)])
    axes.grid(False, axis="y")
    axes.set_xlim(0.0, None)
    axes.set_xlabel("utilisation: factor times load over capacity; error by chance and by the step")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return style.save(figure, path)
