"""The report as Markdown: tables of the values, pictures, and omissions."""

from __future__ import annotations

from dropper_jax.base.markdown import bullets, cells, markdown_table, table
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import literal
from dropper_jax.report import sections
from dropper_jax.report.parts import bodies_text, crop_text, parts_text
from dropper_jax.report.sections import empty_unless_rows, newton, table_of, with_position
from dropper_jax.run.flow_coefficients import flow_cells
from dropper_jax.run.line_weights import weight_cells
from dropper_jax.scene import link_mass_words


def markdown(found: Table, pictures: list[dict[str, str]]) -> str:
    """The complete report.

    Args:
        pictures: paths from the report's folder, by name, of each run.
    """
    runs = found["runs"]
    parts = [f"# Report: {literal(', '.join(dict.fromkeys(run['scene'] for run in runs)))}", _overview(runs)]
    for number, (run, files) in enumerate(zip(runs, pictures, strict=True), start=1):
        if len(runs) > 1:
            parts.append(f"# Run {number}: {literal(run['file'])}")
        parts += _run(run, files)
    if len(runs) > 1:
        parts += ["# Between the runs", _spread(found["spread"])]
    parts += [
        f"# Extremes of a storm of {found['settings']['storm']['value'] / 3600:g} h",
        _extremes(found["extremes"]),
    ]
    if any("extremes" in files for files in pictures):
        parts.append("![extremes](extremes.png)")
    parts += ["# Settings", _settings(found["settings"])]
    return "\n\n".join(part for part in parts if part) + "\n"


def _overview(runs: list[Table]) -> str:
    return table_of(
        [
            {
                "run": run["file"],
                "status": run["status"],
                "time [s]": f"{run['from_s']:g} to {run['to_s']:g}",
                "samples every [s]": f"{run['saved_every_s']:g}",
                "step [s]": f"{run['dt_s']:g}",
            }
            for run in runs
        ]
    )


def _run(run: Table, files: dict[str, str]) -> list[str]:
    def picture(name: str) -> str:
        if name in files:
            return f"![{name.replace('_', ' ')}]({files[name]})"
        return ""

    notes = (*run["notes"], f"Mass of links: {link_mass_words(run['link_mass_nodes'])}.")
    return [
        bullets(map(literal, notes)),
        *parts_text(run.get("parts")),
        "## Tension",
        sections.tension(run["tension"]),
        picture("tension_range"),
        "## Fixed points",
        sections.section(run["anchors"], sections.anchors),
        picture("anchors"),
        *_bending(run.get("bending")),
        "## Snap loads",
        sections.snaps(run["snap"]),
        "## Fatigue",
        sections.section(run["fatigue"], sections.fatigue),
        picture("fatigue"),
        "## Watch circles",
        sections.watch(run["watch_circle"]) if run["watch_circle"] else "No point moves.",
        picture("watch_circle"),
        "## Water",
        sections.water(run["submergence"]),
        "## Accelerations",
        sections.acceleration(run["acceleration"]),
        "## Distance between lines",
        sections.section(run["distance"], sections.distance),
        "## Seabed",
        sections.section(run["seabed"], sections.seabed),
        picture("along"),
        *_weights(run["line_weights"]),
        *_coefficients(run.get("coefficients")),
        *bodies_text(run.get("bodies")),
        *crop_text(run.get("crop")),
    ]


def _weights(rows: list[Table]) -> list[str]:
    """Weights of lines in water; empty without water."""
    if not rows:
        return []
    return ["## Weights of lines", markdown_table(weight_cells(rows))]


@empty_unless_rows
def _bending(found: list[Table]) -> list[str]:
    """Moments and radii; empty if lines have no bending stiffness."""
    rows = []
    for line in found:
        rows.append(
            {
                "line": line["line"],
                "largest moment [N m]": with_position(line, f"{line['largest_moment_n_m']:.4g}"),
                "smallest radius [m]": "straight"
                if line["least_radius_m"] is None
                else f"{line['least_radius_m']:.3g}",
            }
        )
    return ["## Bending", table_of(rows)]


@empty_unless_rows
def _coefficients(found: list[Table]) -> list[str]:
    """Flow-dependent coefficients; empty without any."""
    return ["## Coefficients from the flow", markdown_table(flow_cells(found))]


#: Maximum number of runs with values side by side.
FEW_RUNS = 6


def _spread(section: Table) -> str:
    """Minimum, mean and maximum over the runs; for a few runs also the value of each run, as needed by a sweep over
    steps."""
    few = len(section["dt_s"]) <= FEW_RUNS
    own = []
    if few:
        own = [f"run {i + 1}" for i in range(len(section["dt_s"]))]
    rows = [
        ["step [s]", "", "", "", *cells(section["dt_s"][: len(own)], "g")],
        [
            "internal damping, maximum [N s]",
            *("", "", ""),
            *map(newton, section["internal_damping_n_s"][: len(own)]),
        ],
    ]
    for name, v in section["values"].items():
        values = [v["min"], v["mean"], v["max"], *v["by_run"][: len(own)]]
        if name.startswith(("tension of", "load of")):
            label = f"largest {name}"
        else:
            label = name
        rows.append([label, *cells(values, ".4g")])
    return table(["loads in N", "least", "mean", "largest", *own], rows)


def _extremes(section: Table) -> str:
    if isinstance(section.get("skipped"), str):
        return f"Left out: {section['skipped']}."
    rows = []
    for name, one in section.items():
        if "skipped" in one:
            keys = ()
        else:
            keys = ("most_probable", "mean", "percentile_90")
        rows.append([name, *([_with_interval(one, key) for key in keys] or (one["skipped"], "-", "-"))])
    level = next((one["confidence"] for one in section.values() if "confidence" in one), None)
    what = ""
    if level is not None:
        what = f" [N], {100 * level:g} % interval"
    return table(["maximum in the storm", f"most probable{what}", f"mean{what}", f"90th percentile{what}"], rows)


def _with_interval(one: Table, key: str) -> str:
    low, high = one[f"{key}_interval"]
    return f"{newton(one[key])} ({newton(low)} to {newton(high)})"


def _settings(settings: Table) -> str:
    return table_of(
        [
            {
                "setting": key,
                "meaning": s["meaning"],
                "value": "none" if s["value"] is None else f"{s['value']:g} {s['unit']}".replace(" -", ""),
            }
            for key, s in settings.items()
        ]
    )
