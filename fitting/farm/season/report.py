"""The report of a season: a Markdown page with a picture, a CSV file of the months, and plain values."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.markdown import bullets, cell, markdown_table, text_row
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.plots import figures, style
from fitting.farm.site.report_files import write_report

COLUMNS = (
    "month",
    "wet_weight_n",
    "mussels_wet_n",
    "need_n",
    "least_need_n",
    "least",
    "most",
    "floats",
    "change",
    "reserve",
    "deepest_m",
    "shallowest_m",
    "sinking_m",
    "lifting_m",
    "holds",
)
#: What the page says of the schedule.
ABOUT = (
    "Visits: {visits}, floats moved: {handled}. A float lifts {lift_n:.0f} N. The required reserve is "
    "{wanted_reserve:g}, and floats carry at least {least_share:.0%} of their lift. Depths are those at rest below the "
    "water's level, over all levels and currents."
)


def write_season(found: Table, folder: str | Path) -> dict[str, Path]:
    """Write season.md, season.csv, season.json and season.png into a folder; returns their paths by name."""
    files = write_report(Path(folder), "season", found, page_text(found), COLUMNS, found["months"])
    return {**files, "picture": draw_season(found, Path(folder) / "season.png")}


def page_text(found: Table) -> str:
    """The page as Markdown."""
    verdict = "The schedule does not hold: see below."
    if found["holds"]:
        verdict = "The schedule holds in every month."
    head = ["month", "wet weight [N]", "to carry [N]", "allowed", "floats", "change", "reserve", "backbone [m]"]
    parts = [
        f"# Season: {found['site']}",
        f"{verdict} {ABOUT.format_map(found)}",
        bullets(found["flags"]),
        markdown_table([*head, "to sinking [m]", "to lifting [m]"], *map(_month_cells, found["months"])),
        "![Floats and their bounds](season.png)",
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _month_cells(row: Table) -> tuple[str, ...]:
    """A month of the page's table."""
    change = f"{row['change']:+d}" if row["change"] else "-"
    margins = ["no limit" if row[key] is None else f"{row[key]:+.2f}" for key in ("sinking_m", "lifting_m")]
    return text_row(
        "{0[month]}|{0[wet_weight_n]:.0f}|{0[need_n]:.0f}|{0[least]} to {0[most]}|{0[floats]}|{1}|{2}|"
        "{0[shallowest_m]:.2f} to {0[deepest_m]:.2f}|{3}|{4}",
        *(row, change, cell(row["reserve"], ".2f"), *margins),
    )


#: Height up to which an unlimited number of floats is drawn, over the maximum of all others.
UNLIMITED_HEIGHT = 1.5
#: Maximum number of months whose names fit next to one another.
MAX_UPRIGHT = 6


@style.plot_style()
def draw_season(found: Table, path: Path) -> Path:
    """Draw floats of each month between their bounds, and the depths of the backbone."""
    months = found["months"]
    number = range(len(months))
    figure = figures.new_figure(7.5, 4.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    floats = np.array(column(months, "floats"))
    minimum = np.array(column(months, "least"))
    maximum = np.array(column(months, "most"))
    # no limit on floats is UNLIMITED: cut at 1.5 times the others
    highest = int(UNLIMITED_HEIGHT * max(floats.max(), minimum.max())) + 1
    top = np.clip(maximum, minimum, np.maximum(minimum, highest))
    upper.fill_between(number, minimum, top, step="mid", color=style.LIGHT, label="allowed")
    upper.step(number, floats, where="mid", color=style.FIRST, lw=2, label="floats")
    upper.set(ylabel="floats", ylim=(0.0, None))
    upper.locator_params(axis="y", integer=True)
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    for key, margin, sign, colour in (
        ("shallowest_m", "lifting_m", -1, style.CYCLE[5]),
        ("deepest_m", "sinking_m", 1, style.DARK),
    ):
        lower.plot(number, [row[key] for row in months], "o-", ms=3.5, color=colour, label=key.removesuffix("_m"))
        # the limit is the same in every month
        if months[0][margin] is not None:
            lower.axhline(months[0][key] + sign * months[0][margin], color=colour, lw=1, ls="--", label="its limit")
    lower.invert_yaxis()
    # half a name of a month on either side
    lower.set(ylabel="backbone, depth [m]", xlim=(-0.4, len(months) - 0.6))
    lower.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)
    rotation = 30 if len(months) > MAX_UPRIGHT else 0
    lower.set_xticks(list(number), [row["month"] for row in months], rotation=rotation)
    return figures.save(figure, path)
