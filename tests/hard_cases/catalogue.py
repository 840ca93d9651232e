"""The list of hard cases of `dropper stability`: python tests/hard_cases/catalogue.py writes it.

The scenes are made here, and what their runs are compared with: closed forms and SciPy's solutions. The package has the
list as data, `dropper_jax/data/hard_cases.json`, and measures it; a test holds the data to what is made here.
"""

import json
from pathlib import Path

import breaking_cases
import contact_cases
import energy_cases
import flow_cases
import line_cases
import moving_end_cases
import rod_cases
import rope_cases
import sea_cases

FILE = Path(__file__).parents[2] / "dropper_jax" / "data" / "hard_cases.json"
PARTS = (
    energy_cases,
    contact_cases,
    rope_cases,
    moving_end_cases,
    breaking_cases,
    sea_cases,
    flow_cases,
    line_cases,
    rod_cases,
)


def catalogue() -> dict:
    """The list: scenes by name, each of them once, and rows that name them."""
    scenes, cases = {}, []
    for part in PARTS:
        for row in part.cases():
            named = {key: _name(scenes, row[key], row["name"]) for key in ("scene", "short_scene") if key in row}
            cases.append({**row, **named})
    return {"scenes": scenes, "cases": cases}


def _name(scenes: dict, scene, case: str) -> str:
    """The name of a scene, which is entered under that of its first case."""
    if isinstance(scene, str):
        return scene
    table = scene.to_dict()
    known = next((name for name, one in scenes.items() if one == table), None)
    if known is None:
        known = case if case not in scenes else f"{case}-short"
        scenes[known] = table
    return known


def text(found: dict) -> str:
    """The list with a line per scene and per case."""
    scenes = ",\n".join(f"{json.dumps(name)}: {json.dumps(table)}" for name, table in found["scenes"].items())
    cases = ",\n".join(json.dumps(row) for row in found["cases"])
    return f'{{"scenes": {{\n{scenes}\n}}, "cases": [\n{cases}\n]}}\n'


if __name__ == "__main__":
    FILE.write_text(text(catalogue()), encoding="utf-8")
    print(f"{FILE.name}: {FILE.stat().st_size / 1e3:.0f} kB")
