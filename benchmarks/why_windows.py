"""The picture of docs/calibration.md: why one long run cannot be fitted, and windows can.

python benchmarks/why_windows.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitting.calibration.fit import estimate, prepare
from fitting.report.why import draw_scan, scan
from fitting.traces.synthetic import Camera, observe, simulate_truth

SCENE, NAME, TRUTH = "dropper-release-a", "effects.linear_damping.b_l", 0.002
PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "why_windows.png"
#: Long enough for the needle to show, short enough for a picture in a minute [s].
DURATION = 24.0
#: Values of b_l: over everything that could be, and around the truth.
VALUES = np.sort(np.concatenate([np.linspace(0.0, 0.01, 41), TRUTH * (1 + np.linspace(-0.1, 0.1, 41))]))


def main() -> None:
    trace = observe(simulate_truth(SCENE, DURATION), Camera(angle_noise=0.005), 0)
    prepared = prepare(trace, SCENE, [NAME], window=1.0)
    found = scan(prepared, NAME, np.unique(VALUES), estimate(prepared, "shooting"))
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    print(draw_scan(found, NAME, TRUTH, PICTURE))


if __name__ == "__main__":
    main()
