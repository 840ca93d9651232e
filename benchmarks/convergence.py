"""How loads converge as the step falls, under the law that lines have by default.

    python benchmarks/convergence.py [--scenes NAME ...] [--out benchmarks/results/convergence.json]

Five halvings of each scene's step, energy_momentum, the scene's own start, `SKIP` seconds left out, each line at its
link of the largest tension. A load of a step agrees with the finest run's where it differs by at most its share of it,
or by at most twice the standard error of the difference by batch means, which is what chance between two chaotic runs
makes. Single largest tensions are shown, not judged.
"""

import jax
import numpy as np
from error_bars import chain
from study import RESULTS, Found, command, describe, say, store, stored

import dropper_jax as dj

dj.one_kernel()

#: Scene, its largest step [s], simulated time [s], window of maxima [s].
SCENES: dict[str, tuple] = {
    "paper-case-1": ("paper-case-1", 0.02, 60.0, 8.33),
    "paper-case-3": ("paper-case-3", 0.02, 60.0, 8.33),
    "edulis-longline": ("edulis-longline", 0.03, 60.0, 8.0),
    "chain driven gently": (chain(0.5, 5.0, 17.0), 0.08, 17.0, 5.0),
}
HALVINGS, SKIP, BATCHES = 5, 10.0, 8
#: Share of the finest run's load within which a load agrees.
WITHIN = {"mean": 0.01, "deviation": 0.02, "quantile": 0.03, "window maximum": 0.05}


def tensions(given, dt: float, duration: float) -> tuple[np.ndarray, np.ndarray, list[slice]]:
    """Times (q,) [s] after `SKIP`, tensions (q, n) [N], the links of each line."""
    found = dj.simulate(given, dt=dt, duration=duration, save_every=1)
    if found.status != "ok":
        raise SystemExit(f"{given} at {dt} s: {found.failure}")
    after = found.t_tension > SKIP
    return found.t_tension[after], found.tension[after], [line.links for line in found.lines]


def loads(t: np.ndarray, values: np.ndarray, window: float) -> dict[str, float]:
    """The judged loads of one link's tension (q,) [N], and its largest."""
    count = max(int((t[-1] - t[0]) / window), 1)
    number = np.minimum(((t - t[0]) / (t[-1] - t[0]) * count).astype(int), count - 1)
    tops = [values[number == i].max() for i in range(count)]
    return {
        "mean": float(values.mean()),
        "deviation": float(values.std()),
        "quantile": float(np.quantile(values, 0.999)),
        "window maximum": float(np.mean(tops)),
        "largest": float(values.max()),
    }


def chance(t: np.ndarray, values: np.ndarray, t_fine: np.ndarray, fine: np.ndarray, window: float) -> dict[str, float]:
    """Standard error of the difference of two runs' loads, by batches of the record."""
    edges = np.linspace(t[0], t[-1], BATCHES + 1)
    rows = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        a, b = (t >= low) & (t <= high), (t_fine >= low) & (t_fine <= high)
        ours, theirs = loads(t[a], values[a], window), loads(t_fine[b], fine[b], window)
        rows.append([ours[name] - theirs[name] for name in WITHIN])
    spread = np.std(rows, axis=0, ddof=1) / np.sqrt(BATCHES)
    return dict(zip(WITHIN, map(float, spread), strict=True))


def study(given, largest: float, duration: float, window: float) -> list[Found]:
    """A row per step: by load the worst relative difference from the finest run over the lines, and how many agree."""
    t_fine, fine, lines = tensions(given, largest / 2**HALVINGS, duration)
    where = [line.start + int(np.argmax(fine[:, line].max(axis=0))) for line in lines]
    rows = []
    for k in range(HALVINGS):
        t, found, _ = tensions(given, largest / 2**k, duration)
        row = {"dt": largest / 2**k, "lines": len(lines)}
        compared = []
        for link in where:
            ours, right = loads(t, found[:, link], window), loads(t_fine, fine[:, link], window)
            compared.append((ours, right, chance(t, found[:, link], t_fine, fine[:, link], window)))
        for name in (*WITHIN, "largest"):
            apart = [
                abs(ours[name] - right[name]) / max(abs(right[name]), 1e-3 * right["largest"])
                for ours, right, _ in compared
            ]
            row[name] = float(max(apart))
            if name in WITHIN:
                agree = [
                    share <= WITHIN[name] or abs(ours[name] - right[name]) <= 2.0 * error[name]
                    for share, (ours, right, error) in zip(apart, compared, strict=True)
                ]
                row[f"{name} agrees"] = int(sum(agree))
        rows.append(row)
        say(row)
    return rows


@command(scenes=list(SCENES), out=RESULTS / "convergence.json")
def main(args) -> None:
    found = stored(args.out, {"scenes": {}})["scenes"]
    for name in args.scenes:
        found[name] = study(*SCENES[name])
        store(args.out, {"machine": describe(), "jax": jax.__version__, "scenes": found})
