"""Damping by gradient descent from ten times off, beside Gauss-Newton: path, time and error of each.

    python benchmarks/descent.py [--picture] [--only METHOD ...] [--droppers 0:5 [--adam]]

A synthetic trace of the lab dropper (scenario A, 16 s, 60 Hz, 5 mrad). Every method has the same windows, joined at a
gap weight that its own evidence chooses, and the same exact derivatives. Processor times are those of a second fit,
whose programs are kept in the folder DROPPER_COMPILE_CACHE. `--picture` draws what is stored. `--droppers` compares the
methods on these seeds of `random_droppers.py` instead, from five times off; every row is stored at once.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib.style
import numpy as np
from random_droppers import NAMES
from random_droppers import draw as draw_rig
from study import Found, collect, command, describe, stored, timed

import dropper_jax as dj
from dropper_jax.plots import style
from fitting import Camera, Trace, fit, observe, simulate_truth

PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "descent.png"
SCENE, DURATION, NOISE, TIMES_OFF = "dropper-release-a", 16.0, 0.005, 10.0
METHODS: dict[str, Found] = {
    "Gauss-Newton": {},
    "L-BFGS (optax)": {"method": "gradient"},
    "Adam (optax)": {"method": "gradient", "optimizer": "adam"},
    "Gauss-Newton, dense": {},
}


def lab_trace(times_off: float) -> tuple[Trace, dj.Scene, Found]:
    """A synthetic trace of the lab dropper, its scene with damping this many times off, and what is stored of it."""
    scene = dj.load_scene(SCENE)
    truth = {name: scene.value(name) for name in NAMES}
    trace = observe(simulate_truth(scene, DURATION, 60.0), Camera(rate=60.0, angle_noise=NOISE), seed=0)
    wrong = scene.with_values({name: times_off * value for name, value in truth.items()})
    head = {"scene": SCENE, "duration_s": DURATION, "noise_rad": NOISE, "truth": list(truth.values())}
    return trace, wrong, {**head, "machine": describe()}


def measure(trace: Trace, wrong: dj.Scene, only: Sequence[str]) -> Iterator[Found]:
    """Fits by these methods; each compiles its own programs, and the time of that stands apart."""
    for label in only:
        rig = wrong.with_values({"run.solver": "dense"}) if label.endswith("dense") else wrong
        for _ in range(2):  # the first one compiles
            result, seconds = timed(lambda rig=rig, label=label: fit(trace, rig, ["b_l", "b_q"], **METHODS[label]))
        first = [p.value for p in result.parameters]
        yield {
            "method": label,
            "status": result.status,
            "evaluations": result.iterations,
            "run_s": result.seconds["run"],
            "compile_s": result.seconds["compile"],
            "processor_s": seconds["processor_s"],
            "gap_weight": result.solution.gap_weight,
            "values": list(result.values),
            "std_errors": list(result.uncertainty.std_error),
            "path": [first, *(point["values"] for point in result.solution.history)],
        }


def dropper(seed: int, labels: Sequence[str]) -> Found:
    """Descents compared with Gauss-Newton: distance of estimates [standard errors], ratios of errors and of times."""
    rig = draw_rig(seed)

    def fitted(label: str) -> tuple:
        result, seconds = timed(lambda: fit([rig.trace], rig.scene, start=rig.start, **METHODS[label]))
        return result, seconds["processor_s"]

    fitted("Gauss-Newton")  # compiles what all methods use
    usual, seconds = fitted("Gauss-Newton")
    error = np.array(usual.uncertainty.std_error)
    row = {"seed": seed, "links": rig.trace.links, "peak": rig.peak, "status": usual.status, "processor_s": seconds}
    for label in labels:
        result, own = fitted(label)
        row[label] = {
            "status": result.status,
            "same_gap_weight": result.solution.gap_weight == usual.solution.gap_weight,
            "apart": float(np.max(np.abs(result.values - usual.values) / error)),
            "error_ratios": (result.uncertainty.std_error / error).tolist(),
            "times": own / seconds,
        }
    return row


def draw(found: Found) -> None:
    """Distance to the truth, coefficient by coefficient, along the way of every method."""
    truth = np.array(found["truth"])
    with matplotlib.style.context(["default", style.RC]):
        figure = style.new_figure(9.0, 3.2)
        for i, (axes, name) in enumerate(zip(figure.subplots(1, 2), ("b_l [kg/s]", "b_q [kg/m]"), strict=True)):
            for row, colour in zip(found["rows"][:3], style.CYCLE, strict=False):
                path = np.array(row["path"])[:, i]
                axes.plot(np.arange(len(path)), path, color=colour, lw=1.3, label=row["method"])
                axes.plot(len(path) - 1, path[-1], "o", ms=4, color=colour)
            axes.axhline(truth[i], color=style.DARK, lw=0.8, ls="--")
            axes.annotate("truth", (axes.get_xlim()[1], truth[i]), (-4, 3), textcoords="offset points", ha="right")
            axes.set(xlabel="step", ylabel=name, yscale="symlog")
            axes.set_yscale("symlog", linthresh=0.2 * truth[i])
            axes.set_ylim(0, 20 * truth[i])
        axes.legend(loc="upper right")
        style.save(figure, PICTURE)


@command(picture=False, only=list(METHODS), droppers="", adam=False)
def main(args):
    if args.droppers:
        seeds = range(*map(int, args.droppers.split(":")))
        labels = list(METHODS)[1 : 3 if args.adam else 2]
        collect("descent", {"droppers": (dropper(seed, labels) for seed in seeds)}, by="seed")
        return
    if not args.picture:
        trace, wrong, head = lab_trace(TIMES_OFF)
        collect("descent", {"rows": measure(trace, wrong, args.only)}, by="method", **head)
    draw(stored("descent"))
