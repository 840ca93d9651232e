"""Tables of `spoilers.py`: what was named first, how often intervals cover, errors against their bound.

python benchmarks/spoilers_tables.py [FILE]
"""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results" / "spoilers.json"
TRUTH = np.array([4e-3, 4e-3])


def kind_of(name: str) -> str:
    """A first name without its numbers."""
    if "lost frames" in name:
        return "lost frames"
    return re.sub(r" (\d|\(.*\))", "", name).replace("place of", "position of") or "nothing"


def right(row: dict[str, Any]) -> bool:
    """Whether the first name is the spoiler, its link or node as well."""
    first = row["first"]
    if row["spoiler"] == "lengths and roll":
        return all(any(part in name for name in row["names"]) for part in ("lengths", "roll"))
    if row["truth"] in ("outliers", "lost frames"):
        return kind_of(first) == row["truth"]
    return first.split(" or ")[0] == row["truth"]


def main() -> None:
    rows = json.loads(Path(sys.argv[1] if len(sys.argv) > 1 else RESULTS).read_text())
    clean = np.median([row["std_error"] for row in rows if row["spoiler"] == "clean"], axis=0)
    head = ("systematic error", "draws", "right name first", "cover b_l, b_q", "RMS error/SE", "SE/bound", "maximum")
    print("| " + " | ".join((*head, "SE/clean")) + " |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    kinds = list(dict.fromkeys(row["spoiler"] for row in rows))
    for kind in kinds:
        some = [row for row in rows if row["spoiler"] == kind]
        value, se, low, high, bound = (
            np.array([row[key] for row in some]) for key in ("values", "std_error", "low", "high", "bound")
        )
        cover = ((low <= TRUTH) & (high >= TRUTH)).sum(axis=0)
        z = np.sqrt(np.mean(((value - TRUTH) / se) ** 2, axis=0))
        ratio = se / bound
        named = sum(right(row) for row in some)
        print(
            f"| {kind} | {len(some)} | {named} | {cover[0]}, {cover[1]} | {z[0]:.2f}, {z[1]:.2f} | "
            f"{np.median(ratio):.2f} | {ratio.max():.2f} | {np.median(se / clean):.2f} |"
        )
    names = list(dict.fromkeys(kind_of(row["first"]) for row in rows))
    print("\n| truth | " + " | ".join(names) + " |\n" + "| --- " * (len(names) + 1) + "|")
    for kind in kinds:
        count = Counter(kind_of(row["first"]) for row in rows if row["spoiler"] == kind)
        print(f"| {kind} | " + " | ".join(str(count[name] or "") for name in names) + " |")


if __name__ == "__main__":
    main()
