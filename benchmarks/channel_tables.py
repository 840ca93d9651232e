"""The table of docs/fit-any-channel.md, from what `channels.py` measured."""

from __future__ import annotations

from typing import Any

#: Cases in words, by their place in the results.
CASES = {
    ("sea", "taut"): "longline, taut ropes",
    ("sea", "slack"): "longline, slack ropes",
    ("sea", "stiff"): "longline, slack and stiff",
    ("cable", "stiff"): "cable, markers on every node",
    ("cable", "limp"): "limp cable, one marker",
    ("runs",): "five releases, damping differs by 5 %",
    ("cameras",): "kicked chain, two cameras",
}


def channels(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of cases and parameters, with a heading."""
    rows = [
        ("case", "parameter", "draws", "90 % intervals cover", "RMS of error/std error", "median std error", "verdict")
    ]
    for place, words in CASES.items():
        case = found
        for key in place:
            case = case.get(key, {})
        for name, row in case.get("parameters", {}).items():
            n = case["draws"]
            relative = row["median_relative_error"]
            error = "-" if relative is None else f"{100 * relative:.2g} %"
            said = [f"{words_} in {row[key]}" for key, words_ in VERDICTS.items() if row[key]]
            numbers = (f"{row['cover']}", f"{row['rms_of_error_over_std_error']:.2f}", error)
            rows.append((words, f"`{name.removeprefix('effects.')}`", str(n), *numbers, ", ".join(said)))
    return rows


VERDICTS = {"not_determined": "not determined", "upper_bound": "upper bound"}
