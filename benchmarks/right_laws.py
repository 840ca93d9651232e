"""Does a right law end `ok`? Fits of random droppers and of clean four-link chains, with the tests of the law.

    python benchmarks/right_laws.py [--seeds 1000:1040] [--clean 100:160] [--only droppers chains] [--out FILE]

Droppers are the draws of `random_droppers`, chains those of `spoilers` without a systematic error; their seeds are
others than those of these two studies. Written are status, the least probability of the tests of the law, the estimates
and their errors. Writes results/right_laws.json.
"""

import random_droppers
import spoilers
from study import RESULTS, Found, collect, command, seeds_of, timed

from dropper_jax import SceneError
from fitting import prepare
from fitting.calibration.summarise import summarise
from fitting.estimate.simulator import Simulator
from fitting.windows.method import estimate
from fitting.windows.sound_windows import with_sound_windows

PARTS = ["droppers", "chains"]


def dropper(seed: int) -> Found:
    """The default fit of a random dropper."""
    d = random_droppers.draw(seed)
    try:
        return random_droppers.judge(d, 0.0)
    except SceneError as error:
        return {"seed": seed, "status": "invalid_input", "message": str(error)}


def chain(seed: int, shared: list[Simulator]) -> Found:
    """The default fit of a clean chain, by programs that earlier fits have compiled."""
    _, trace = spoilers.draw("clean", seed)
    options = {"settings": spoilers.SETTINGS, "simulator": shared[0] if shared else None}
    prepared = prepare(trace, spoilers.scene(), spoilers.FREE, **options)
    shared[:] = shared or [prepared.simulator]
    result, times = timed(lambda: summarise(prepared, "shooting", estimate(with_sound_windows(prepared))))
    u = result.uncertainty
    return {
        **{"seed": seed, "status": result.status, "message": result.message, "warnings": result.warnings},
        **{"values": result.values.tolist(), "truth": spoilers.TRUTH.tolist(), "std_error": u.std_error.tolist()},
        **{"low": u.low.tolist(), "high": u.high.tolist(), "at_bound": u.at_bound.tolist()},
        **{"least_p": min((test.p for test in result.laws.tests), default=1.0)},
        **{"chi2": result.chi2_per_dof, "gap_weight": result.solution.gap_weight, "seconds": times["processor_s"]},
    }


@command(seeds="1000:1040", clean="100:160", only=PARTS, out=RESULTS / "right_laws.json")
def main(args) -> None:
    shared: list[Simulator] = []
    rows = {
        "droppers": map(dropper, seeds_of(args.seeds)),
        "chains": (chain(seed, shared) for seed in seeds_of(args.clean)),
    }
    collect(args.out, {part: rows[part] for part in args.only}, by="seed")
