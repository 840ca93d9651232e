"""A sweep as text: its cases and speed, tables of its results and of scores against a trace."""

from __future__ import annotations

import math
from pathlib import Path

from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.cli.printing import listing, table

#: Maximum number of cases in a printed table.
MOST_ROWS = 15


def text(found: Table, results: str = "") -> str:
    """The result as text, with a table of inputs and results."""
    counts = ", ".join(f"{count} {status}" for status, count in found["counts"].items() if count)
    about = {
        "scene": "{scene}",
        "cases": "{cases} of {steps_per_case} steps, {resumed} of them resumed",
        "ended": counts,
        "wall time": "{compile_s:.2f} s compilation, {run_s:.2f} s run and saving",
        "speed": "{steps_per_s:.0f} steps per second",
    }
    if found["resumed"] == found["cases"]:  # nothing was run
        del about["speed"]
    pairs = [(name, words.format_map(found)) for name, words in about.items()]
    scores = _score_table(found["trace"]) if "trace" in found else ""
    return "\n\n".join(filter(None, (listing(pairs), results, scores, f"{found['status']}: {found['out']}")))


def _score_table(trace: Table) -> str:
    """The cases with the best head, and the fit: RMS angle error and distance of spectra of each part.

    Cases that failed have no score and are left out.
    """
    spans = trace["parts_s"]
    cases = [case for case in trace["cases"] if case["head"]["angle_rms_rad"] is not None]
    cases.sort(key=lambda case: case["head"]["angle_rms_rad"])
    fit = trace.get("fit")
    names = [path.rsplit(".", 1)[-1] for path in trace["cases"][0]["values"]]
    for part in spans:
        names += [part, f"{part} spectrum"]
    rows = [names]
    shown = cases[:MOST_ROWS]
    if fit:
        shown.append(fit)
    for case in shown:
        scores = []
        for part in spans:
            for score in case[part].values():
                if score is None:
                    score = math.nan
                scores.append(1e3 * score)
        rows.append((*cells(case["values"].values(), ".4g"), *cells(scores, ".3g")))
    named = ", ".join(f"{part} {low:.4g} to {high:.4g} s" for part, (low, high) in spans.items())
    notes = [f"RMS angle error and distance of amplitude spectra [mrad], {named}"]
    if len(cases) > MOST_ROWS:
        notes.append(f"{len(cases) - MOST_ROWS} more cases; use --json to see all")
    if fit:
        notes.append(f"last row: the fit ({fit['status']})")
    return table(rows) + "\n\n" + "; ".join(notes)


def result_table(path: Path) -> str:
    """Inputs and results of each case."""
    from fitting.sweep import open_sweep

    with open_sweep(path) as found:
        # one number for each case: not angles of every link
        names = [x for x, of in found.drop_vars(["status", "failed_at"]).items() if of.dims == found.status.dims]
        frame = found[names].to_dataframe().reset_index()
        columns = [str(name) for name in (*frame.columns.drop(names), *names)]
        heads = []
        for name in columns:
            unit = found[name].attrs.get("units")
            if unit:
                name = f"{name} [{unit}]"
            heads.append(name)
    return table([heads, *(cells(row, ".4g") for row in frame[columns].to_numpy())])
