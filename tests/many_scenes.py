"""Many kinds of scene simulated in one process: memory maps and resident memory, which the kernel bounds.

    python tests/many_scenes.py [--kinds 80]

Kinds differ in the number of links (3 to 40), the effects, the axial law and the scheme, so that each has programs of
its own. The kernel ends a process (or the compiler does) at 65 530 maps; a row is printed after every ten kinds. The
exit code is 1 where a run failed, or `MOST_MAPS` or `MOST_MEMORY` was passed.
"""

import argparse
import itertools
import resource
import sys
import time
from collections.abc import Iterator
from typing import Any

import dropper_jax as dj
from dropper_jax.backend.programs import memory_maps

#: What is allowed: memory maps, and peak resident memory [MB].
MOST_MAPS, MOST_MEMORY = 20_000, 3_000
EFFECTS = (
    {"weight": {}},
    {"weight": {}, "linear_damping": {"b_l": 0.05}},
    {"weight": {}, "linear_damping": {"b_l": 0.05}, "quadratic_damping": {"b_q": 0.02}},
    {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.4, "cdt": 0.02}},
)
SCHEMES = {False: ("energy_momentum", "rattle", "theta"), True: ("energy_momentum", "generalized_alpha", "rk4")}


def scene(links: int, effects: dict[str, Any], elastic: bool, scheme: str) -> dict[str, Any]:
    """A hanging line let go from a straight, slanted pose."""
    line = {"name": "line", "from": "a", "to": "b", "links": links, "length": 0.1, "mass": 0.5, "diameter": 0.03}
    axial = {"axial": {"law": "elastic", "EA": 2e4, "damping": 0.001}} if elastic else {}
    return {
        "run": {"dt": 0.0005, "duration": 0.01, "integrator": scheme},
        "point": [
            {"name": "a", "position": [0.0, 0.0, -1.0]},
            {"name": "b", "kind": "free", "position": [0.1 * links, 0.0, -1.0]},
        ],
        "line": [line | axial],
        "sea": {"depth": 20.0},
        "effects": effects,
        "start": {"kind": "angles", "polar": [0.3] * links},
    }


def kinds() -> Iterator[dict[str, Any]]:
    """Scenes of different kinds, neighbours as different as they can be."""
    for round_, links in itertools.product(range(12), range(3, 41)):
        elastic = bool((links + round_) % 2)
        schemes = SCHEMES[elastic]
        scheme = schemes[(links // 2 + round_) % len(schemes)]
        yield scene(links, EFFECTS[(links + round_ // 2) % len(EFFECTS)], elastic, scheme)


def show(*cells: object) -> None:
    print(*cells, sep="  ", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", type=int, default=80)
    count = parser.parse_args().kinds
    show("kinds", "maps", "peak MB", "processor s", "ok")
    good, most = 0, 0
    for done, values in enumerate(itertools.islice(kinds(), count), start=1):
        good += dj.simulate(values).status == "ok"
        most = max(most, memory_maps())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        if done % 10 == 0 or done == count:
            show(done, memory_maps(), peak, f"{time.process_time():.0f}", good)
    return int(good < count or most > MOST_MAPS or peak > MOST_MEMORY)


if __name__ == "__main__":
    sys.exit(main())
