"""The report as Markdown: tables of the values, pictures, and the reasons for omitted sections."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from dropper_jax.base.markdown import bullets, cells, literal, markdown_table
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.base.table_cells import Columns, fill, newton
from dropper_jax.report import sections
from dropper_jax.report.tables import table_of
from dropper_jax.scene import link_mass_words


def report_markdown(found: Table, pictures: list[dict[str, str]]) -> str:
    """The complete report.

    Args:
        pictures: paths from the report's folder, by name, of each run.
    """
    runs = found["runs"]
    scenes = dict.fromkeys(column(runs, "scene"))
    parts = [f"# Report: {literal(', '.join(scenes))}", table_of(OVERVIEW, runs)]
    for number, (run, files) in enumerate(zip(runs, pictures, strict=True), start=1):
        if len(runs) > 1:
            parts.append(f"# Run {number}: {literal(run['file'])}")
        parts += _run_parts(run, files)
    if len(runs) > 1:
        parts += ["# Between the runs", _spread(found["spread"])]
    parts += [
        f"# Extremes of a storm of {found['settings']['storm']['value'] / 3600:g} h",
        _extremes(found["extremes"]),
    ]
    if any("extremes" in files for files in pictures):
        parts.append("![extremes](extremes.png)")
    parts += ["# Settings", _settings(found["settings"])]
    return "\n\n".join(filter(None, parts)) + "\n"


def _steps_of(run: Table) -> str:
    """The step of a run, or the accuracy that its steps follow."""
    if run["accuracy"] is None:
        return fill("{dt_s:g}", run)
    return fill("by accuracy {accuracy:g}", run)


OVERVIEW: Columns = {
    "run": "{file}",
    "status": "{status}",
    "time [s]": "{from_s:g} to {to_s:g}",
    "samples every [s]": "{saved_every_s:g}",
    "step [s]": _steps_of,
}


class Section(NamedTuple):
    """A section of a run: its key in the report, its heading, and the function that writes its values.

    The picture, if there is one, follows the text. An `optional` section is omitted for a run without its values, any
    other one gives the reason.
    """

    key: str
    heading: str
    write: Callable[[Any], str]
    picture: str = ""
    optional: bool = False


SECTIONS = (
    Section("parts", "Parts", sections.parts, optional=True),
    Section("tension", "Tension", sections.tension, "tension_range"),
    Section("anchors", "Fixed points", sections.anchors, "anchors"),
    Section("bending", "Bending", sections.bending, optional=True),
    Section("snap", "Snap loads", sections.snaps),
    Section("fatigue", "Fatigue", sections.fatigue, "fatigue"),
    Section("watch_circle", "Watch circles", sections.watch, "watch_circle"),
    Section("submergence", "Water", sections.water),
    Section("acceleration", "Accelerations", sections.acceleration),
    Section("distance", "Distance between lines", sections.distance),
    Section("seabed", "Seabed", sections.seabed, "along"),
    Section("line_weights", "Weights of lines", sections.weights, optional=True),
    Section("coefficients", "Coefficients from the flow", sections.coefficients, optional=True),
    Section("bodies", "Bodies", sections.bodies, optional=True),
    Section("crop", "Mussels", sections.crop, optional=True),
)


def _run_parts(run: Table, files: dict[str, str]) -> list[str]:
    """Notes, sections and pictures of a run."""
    notes = (*run["notes"], f"Mass of links: {link_mass_words(run['link_mass_nodes'])}.")
    parts = [bullets(map(literal, notes))]
    for section in SECTIONS:
        values = run.get(section.key)
        skipped = isinstance(values, dict) and "skipped" in values
        if section.optional and (skipped or not values):
            continue
        parts.append(f"## {section.heading}")
        if skipped:
            parts.append(f"Left out: {values['skipped']}.")
        else:
            parts.append(section.write(values))
        if section.picture in files:
            parts.append(f"![{section.picture.replace('_', ' ')}]({files[section.picture]})")
    return parts


#: Maximum number of runs with values side by side.
MAX_RUN_COLUMNS = 6


def _spread(section: Table) -> str:
    """Minimum, mean and maximum over the runs; of up to `MAX_RUN_COLUMNS` also the value of each, to compare steps."""
    count = len(section["dt_s"])
    if count > MAX_RUN_COLUMNS:
        count = 0
    rows = [
        ["step [s]", "", "", "", *cells(section["dt_s"][:count], "g")],
        ["accuracy of steps", "", "", "", *cells(section["accuracy"][:count], "g")],
        ["internal damping, maximum [N s]", "", "", "", *map(newton, section["internal_damping_n_s"][:count])],
    ]
    for name, v in section["values"].items():
        label = name
        if name.startswith(("tension of", "load of")):
            label = f"maximum {name}"
        rows.append([label, *cells([v["min"], v["mean"], v["max"], *v["by_run"][:count]], ".4g")])
    return markdown_table(["loads in N", "minimum", "mean", "maximum", *(f"run {i + 1}" for i in range(count))], *rows)


def _extremes(section: Table) -> str:
    """Maxima of each quantity in a storm with their confidence intervals, or the reason for their absence."""
    if isinstance(section.get("skipped"), str):
        return f"Left out: {section['skipped']}."
    rows = []
    suffix = ""
    for name, one in section.items():
        if "skipped" in one:
            rows.append([name, one["skipped"], "-", "-"])
            continue
        suffix = f" [N], {100 * one['confidence']:g} % interval"
        rows.append([name, *(_with_interval(one, key) for key in ("most_probable", "mean", "percentile_90"))])
    head = ["maximum in the storm", f"most probable{suffix}", f"mean{suffix}", f"90th percentile{suffix}"]
    return markdown_table(head, *rows)


def _with_interval(one: Table, key: str) -> str:
    """A maximum in a storm [N] and its confidence interval in one cell."""
    low, high = one[f"{key}_interval"]
    return f"{newton(one[key])} ({newton(low)} to {newton(high)})"


SETTINGS: Columns = {"setting": "{key}", "meaning": "{meaning}", "value": "{value:g}{suffix}|none"}


def _settings(settings: Table) -> str:
    """The settings of the report: keys, meanings, values with units."""
    rows = []
    for key, one in settings.items():
        suffix = f" {one['unit']}"
        if one["unit"] == "-":
            suffix = ""
        rows.append({**one, "key": key, "suffix": suffix})
    return table_of(SETTINGS, rows)
