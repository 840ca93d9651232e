"""The report of load cases: one Markdown page with a picture, and a CSV file of every part in every case."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dropper_jax.base.markdown import bullets, cell, cells, markdown_table, text_row
from dropper_jax.base.read import Table
from dropper_jax.base.records import column, rows_where
from dropper_jax.plots import figures, style
from fitting.farm.site.report_files import write_report

COLUMNS = (
    "kind",
    "part",
    "case",
    "sea_state",
    "direction_deg",
    "current",
    "level_m",
    "month",
    "crop",
    "state",
    "line",
    "load_n",
    "load_error_n",
    "load_low_n",
    "load_high_n",
    "at_rest_n",
    "mean_n",
    "capacity_n",
    "factor",
    "utilisation",
    "utilisation_error",
    "step_error",
    "damage_per_hour",
)
#: Meaning of `run.characteristic_load`, in words.
CHARACTERISTIC = {"mean": "mean of the seeds' maxima", "most_probable": "most probable maximum of the storm"}
#: Labels of the cases by number.
Labels = dict[int, str]
#: Colours of the bars of parts within and beyond their limits.
WITHIN_COLOUR = "#C9DAEA"
BEYOND_COLOUR = "#F0C9B0"
#: Maximum number of load cases in the page's table; the CSV has all.
MAX_CASES = 12


def write_page(found: Table, folder: str | Path) -> dict[str, Path]:
    """Write cases.md, cases.csv, cases.json and utilisation.png into a folder; returns their paths by name."""
    files = write_report(Path(folder), "cases", found, page_text(found), COLUMNS, _csv_rows(found))
    return {**files, "picture": draw_utilisation(found, Path(folder) / "utilisation.png")}


def page_text(found: Table) -> str:
    """The page's text."""
    labels = {case["case"]: _label(case) for case in found["cases"]}
    parts = [
        f"# Load cases: {found['site']}",
        _verdict(found),
        bullets(found["flags"]),
        "## Parts, each in its worst case",
        markdown_table(
            ["part", "lines", "worst line", "load [N]", "+- seeds", "+- step", "at rest [N]", "utilisation", "case"],
            *(_part_cells(part, labels) for part in found["parts"]),
        ),
        _standard(found),
        "## Factors",
        markdown_table(
            ["part", "factor x load / capacity, worst case", *found["factors"]],
            *(_factor_cells(part) for part in found["parts"]),
        ),
        "![Utilisation](utilisation.png)",
        "## Anchors",
        markdown_table(
            ["point", "held by", "load [N]", "upward [N]", "uplift [deg]", "utilisation", "case"],
            *(_anchor_cells(anchor, labels) for anchor in found["anchors"]),
        ),
        _quantities(found, labels),
        "## Excursion and depth",
        bullets(_position_lines(found, labels)),
        "## Fatigue",
        markdown_table(
            ["part", "curve", "damage per hour, worst case", "damage per year", "life [years]"],
            *(_fatigue_cells(part) for part in found["parts"]),
        ),
        "## Load cases",
        _worst_cases(found, labels),
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _verdict(found: Table) -> str:
    """Whether all limits hold, and what was run."""
    verdict = "A limit is exceeded, or a run is missing: see below."
    if found["passes"]:
        verdict = "All limits hold."
    if found["dt_s"] is None:
        steps = f"accuracy {found['accuracy']:g}"
    else:
        steps = f"steps of {found['dt_s']:g} s"
    return (
        f"{verdict} Load cases: {len(found['cases'])}, seeds of each: {found['seeds']}, {found['duration_s']:g} s of "
        f"which the first {found['skip_s']:g} s do not count, {steps}. Characteristic load: "
        f"{CHARACTERISTIC[found['characteristic']]}. "
        f"Factors: {found['factors']['source']} (edition: {found['factors']['edition']})."
    )


def _standard(found: Table) -> str:
    """Pairs of return periods with their sea states, currents and number of cases; empty without them."""
    standard = found["standard"]
    if standard is None:
        return ""
    rows = []
    for pair in standard["pairs"]:
        cases = [case for case in found["cases"] if list(case["return_periods"]) == pair]
        seas = dict.fromkeys(str(case["sea_state"]) for case in cases)
        currents = dict.fromkeys(str(case["current"]) for case in cases)
        intact = sum(case["state"] == "intact" for case in cases)
        rows.append([*pair, ", ".join(seas), ", ".join(currents), str(intact), str(len(cases) - intact)])
    head = ["waves [years]", "current [years]", "sea states", "currents", "intact cases", "with a broken line"]
    last = f"{standard['source']}. Edition: {standard['edition']}. Clause: {standard['clause']}. "
    last += f"Compared with: {standard['checked']}."
    return f"## Return periods\n\n{last}\n\n{markdown_table(head, *rows)}"


def _factor_cells(part: Table) -> list[str]:
    """The calculation of a part's utilisation, and where its factors come from."""
    calculation = "-"
    if part["worst"] is not None:
        calculation = "{factor:g} x {load_n:.0f} / {capacity_n:.0f} = {utilisation:.3f}".format_map(part["worst"])
    return [part["part"], calculation, *cells(part["factors"].values(), "")]


def _quantities(found: Table, labels: Labels) -> str:
    """The site's quantities, each in the case with its largest value; empty without any."""
    rows = []
    cases = [case for case in found["cases"] if "quantities" in case]
    for name in dict.fromkeys(name for case in cases for name in case["quantities"]):
        worst = max(cases, key=lambda case: abs(case["quantities"][name]["value"]))
        value = worst["quantities"][name]
        error = cell(value["error"], ".2g")
        rows.append(text_row("{0}|{1[value]:.4g}|{2}|{3}", name, value, error, labels[worst["case"]]))
    if not rows:
        return ""
    return "## Quantities\n\n" + markdown_table(["quantity", "value [SI]", "+- seeds", "case"], *rows)


def _part_cells(part: Table, labels: Labels) -> tuple[str, ...]:
    """A part in its worst case."""
    row = part["worst"]
    if row is None:
        return text_row("{0[part]}|{0[lines]}|-|-|-|-|-|-|-", part)
    error = cell(row["load_error_n"], ".0f")
    return text_row(
        "{0[part]}|{0[lines]}|{1[line]}|{1[load_n]:.0f}|{2}|{3}|{1[at_rest_n]:.0f}|{4}|{5}",
        *(part, row, error, _step_error(part["step"]), _utilisation(row), labels[row["case"]]),
    )


def _label(case: Table) -> str:
    """The name of a case, which ends with the line that breaks, and the time of the break [s]."""
    if case["break_s"] is None:
        return case["name"]
    return f"{case['name']} at {case['break_s']:g} s"


def _step_error(step: Table | None) -> str:
    """The error of a part's load by the step [N], and relative."""
    if step is None or "skipped" in step:
        return "not known"
    return f"{step['error_n']:.0f} ({step['relative']:.0%})"


def _utilisation(row: Table) -> str:
    """Utilisation and its error; of a fixed point without an anchor it is not known."""
    if row["utilisation"] is None:
        return "not given"
    used = f"{row['utilisation']:.2f}"
    if row["utilisation_error"] is not None:
        used += f" +- {row['utilisation_error']:.2f}"
    return used


def _anchor_cells(anchor: Table, labels: Labels) -> tuple[str, ...]:
    """A fixed point in its worst case."""
    row = anchor["worst"]
    if row is None:
        return text_row("{0[point]}|-|-|-|-|-|-", anchor)
    uplift = f"{anchor['uplift_deg']:.1f}"
    if anchor["allowed_uplift_deg"] is not None:
        uplift += f" of {anchor['allowed_uplift_deg']:g}"
    return text_row(
        "{0[point]}|{1}|{2[total_n][value]:.0f}|{2[upward_n][value]:.0f}|{3}|{4}|{5}",
        *(anchor, anchor["anchor"] or "not given", row, uplift, _utilisation(row), labels[row["case"]]),
    )


def _position_lines(found: Table, labels: Labels) -> list[str]:
    """Lines on the exclusion zone and on the depth of the backbone."""
    zone = found["exclusion"]
    backbone = found["backbone"]
    if zone is None:
        lines = ["No exclusion zone is given."]
    else:
        lines = [f"Largest excursion {zone['value']:.2f} m of {zone['allowed_m']:g} m, in {labels[zone['case']]}."]
    if backbone is not None:
        low, high = ["any" if limit is None else f"{limit:g}" for limit in backbone["allowed_m"]]
        lines.append(
            f"Depth of the backbone at rest: {backbone['shallowest_m']:.2f} to {backbone['deepest_m']:.2f} m below "
            f"the water's level; allowed: {low} to {high} m."
        )
    return lines


def _fatigue_cells(part: Table) -> tuple[str, ...]:
    """The fatigue curve of a part, its damage and life, or why they are not known."""
    own = part["fatigue"]
    if "skipped" in own:
        return text_row("{0[part]}|{1[skipped]}|-|-|-", part, own)
    hourly = cell(own["largest_damage_per_hour"], ".2g")
    life = cell(own["life_years"], ".3g")
    yearly = own.get("why") or f"{own['damage_per_year']:.2g}"
    return text_row(
        "{0[part]}|K = {1[k]:g}, m = {1[m]:g} ({1[source]})|{2}|{3}|{4}", part, own["curve"], hourly, yearly, life
    )


def _worst_cases(found: Table, labels: Labels) -> str:
    """The cases with the highest utilisation."""
    by_case: dict[int, tuple[float, str]] = {}
    for part in found["parts"]:
        for row in part["cases"]:
            before = by_case.get(row["case"], (0.0, "-"))
            used = (row["utilisation"], part["part"])
            by_case[row["case"]] = max(before, used)
    ordered = sorted(by_case.items(), key=lambda item: -item[1][0])
    rows = [[str(n), labels[n], name, f"{utilisation:.2f}"] for n, (utilisation, name) in ordered[:MAX_CASES]]
    text = markdown_table(["case", "", "part used most", "utilisation"], *rows)
    if len(ordered) > MAX_CASES:
        text += f"\n\n{len(ordered) - MAX_CASES} more in cases.csv."
    return text


def _csv_rows(found: Table) -> Iterator[Table]:
    """Every part and every fixed point in each case."""
    storms = {case["case"]: case for case in found["cases"]}
    for part in found["parts"]:
        own = {"kind": "part", "part": part["part"], "step_error": (part["step"] or {}).get("relative")}
        for row in part["cases"]:
            low, high = row["interval_n"] or (None, None)
            yield {**storms[row["case"]], **row, **own, "load_low_n": low, "load_high_n": high}
    for anchor in found["anchors"]:
        own = {"kind": "anchor", "part": anchor["point"]}
        for row in anchor["cases"]:
            load = row["total_n"]
            low, high = load["interval"] or (None, None)
            loads = {"load_n": load["value"], "load_error_n": load["error"], "load_low_n": low, "load_high_n": high}
            yield {**storms[row["case"]], **row, **own, **loads}


@style.plot_style()
def draw_utilisation(found: Table, path: Path) -> Path:
    """A row for each part and each fixed point with an anchor: dots are cases, bars extend to the worst one."""
    bars = {part["part"]: part for part in found["parts"]}
    bars |= {f"anchor {anchor['point']}": anchor for anchor in found["anchors"] if anchor["anchor"]}
    bars = {name: bar for name, bar in reversed(bars.items()) if bar["worst"] is not None}
    figure = figures.new_figure(7.5, 1.5 + 0.34 * max(len(bars), 1))
    axes = figure.subplots()
    intact = column(rows_where(found["cases"], "state", "intact"), "case")
    for y, bar in enumerate(bars.values()):
        worst = bar["worst"]["utilisation"]
        colour = WITHIN_COLOUR if worst <= 1.0 else BEYOND_COLOUR
        axes.barh(y, worst, height=0.55, color=colour, zorder=1)
        step_error = (bar.get("step") or {}).get("relative", 0.0) * worst
        error = np.hypot(bar["worst"]["utilisation_error"] or 0.0, step_error)
        axes.errorbar(worst, y, xerr=error, color=style.DARK, capsize=3, lw=1, zorder=4)
        used = np.array(column(bar["cases"], "utilisation"))
        is_intact = np.isin(column(bar["cases"], "case"), intact)
        _draw_cases(axes, y, used[is_intact], "intact", style.CYCLE[0])
        _draw_cases(axes, y, used[~is_intact], "a line breaks", style.CYCLE[1])
    axes.axvline(1.0, color=style.ALERT, lw=1, ls="--")
    axes.set_yticks(range(len(bars)), list(bars))
    axes.grid(False, axis="y")
    axes.set(xlim=(0.0, None), xlabel="utilisation: factor times load over capacity; error by chance and by the step")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return figures.save(figure, path)


def _draw_cases(axes: Axes, y: int, used: np.ndarray, label: str, colour: str) -> None:
    """A dot for each case of a row, at its utilisation."""
    if not len(used):
        return
    name = label if y == 0 else None  # once in the legend
    axes.plot(used, np.full(len(used), y), "o", ms=3.5, color=colour, zorder=3, label=name)
