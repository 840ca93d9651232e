"""Derivatives of the anchor tension of the paper's case 4 to numbers of its scene, beside differences of static poses.

    python benchmarks/scene_sensitivity.py

Writes `results/scene_sensitivity.json` (some minutes on a core); `tables.py` makes the table of it.
"""

from study import command, store

import dropper_jax as dj
from fitting.sensitivity import local, study

SCENE, OF, DURATION = "paper-case-4", "tension.1.mean", 0.1
PATHS = (
    "sea.current.speed",
    "buoy.spar.mass",
    "line_type.chain.cdn",
    "line.chain.length",
    "line_type.chain.EA",
)
#: Relative step of the central differences.
STEP = 1e-3


def by_differences(scene: dj.Scene, path: str) -> float:
    """Central difference of the static anchor tension [N per unit of the path]."""
    value = scene.value(path)
    ahead, behind = (dj.equilibrium(scene.with_values({path: value * (1 + s)})).tension[0] for s in (STEP, -STEP))
    return float(ahead - behind) / (2 * STEP * value)


@command()
def main() -> None:
    scene = dj.load_scene(SCENE).with_values({"run.duration": DURATION})
    found = local(study(scene, OF, PATHS), check=True)
    rows = [
        {"path": path, "value": value, "unit": unit, "derivative": slope, "scaled": scaled, "differences": difference}
        for path, value, unit, slope, scaled, difference in zip(
            found.names,
            found.values,
            found.units,
            found.forward,
            found.scaled,
            (by_differences(scene, path) for path in PATHS),
            strict=True,
        )
    ]
    values = {"scene": SCENE, "of": OF, "value": found.value, "modes_differ": found.mismatch, "rows": rows}
    store("scene_sensitivity", values)
