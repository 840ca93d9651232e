"""Two worked examples of a standard by name: a small longline by NS 9415 and by DNV-OS-E301.

    python benchmarks/standards.py

Both run the load cases of the packaged `small-longline` for the return periods of the standard, intact and with a
broken leg. The sea states and currents are examples, not those of a site. Written to `results/standards.json`: pairs,
and each part's factor, load, capacity and utilisation as in the report, with the edition and clause of the numbers.
"""

import tempfile
import tomllib

from study import Found, command, store

from fitting.cases import assess, run_cases
from fitting.site import read_site, site_text

SEEDS = 3
#: Significant wave height [m], peak period [s] and speed of the current [m/s] by return period [years].
CONDITIONS = {10: (2.8, 8.0, 0.7), 50: (3.5, 9.0, 0.9), 100: (3.8, 9.3, 1.0)}
EXAMPLES = {"ns-9415": "ns-9415-rope", "dnv-os-e301": "dnv-os-e301-class-1"}


def example(cases: str, factors: str) -> Found:
    """The load cases of the small longline by a standard, assessed."""
    table = tomllib.loads(site_text("small-longline").decode())
    for key in ("variable", "objective", "optimise"):
        del table[key]
    table["run"]["seeds"] = SEEDS
    table["sea_state"] = [
        {"name": f"{years} years", "hs": hs, "tp": tp, "count": 40, "return_period": years}
        for years, (hs, tp, _) in CONDITIONS.items()
    ]
    currents = [{"speed": speed, "return_period": years} for years, (*_, speed) in CONDITIONS.items()]
    table["cases"] = {"standard": cases, "currents": currents, "states": ["intact", "west-leg"]}
    table["factors"] = {"standard": factors}
    site = read_site(table)
    with tempfile.TemporaryDirectory() as folder:
        run_cases(site, folder)
        found = assess(site, folder, site.prepared().run.dt)
    keys = ("load_n", "capacity_n", "factor", "utilisation", "case", "line")
    names = {case["case"]: case["name"] for case in found["cases"]}
    parts = [
        {"part": p["part"], "factors": p["factors"], **{key: p["worst"][key] for key in keys}} for p in found["parts"]
    ]
    return {
        "standard": found["standard"],
        "cases": [case["name"] for case in found["cases"]],
        "failed": len(found["failed"]),
        "parts": [{**part, "case": names[part["case"]]} for part in parts],
    }


@command()
def main() -> None:
    store("standards", {name: example(name, factors) for name, factors in EXAMPLES.items()})
