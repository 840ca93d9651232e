"""Whether the comparison of damping laws finds the law that made a trace, or says that the trace does not decide.

    python benchmarks/laws.py [--links 1 2 3 7] [--draws 2] [--noise white filtered]

Chains of point masses with a free end, let go at some 60 degrees, simulated with a finer step by another scheme than
the fits take, watched with noise. Truths are every law of one or two parts; each part of two takes a third of the
energy at least. Where leaving a part out costs 10 in log likelihood the truth is strong: it should be found alone. Then
pairs are watched with as much more noise as leaves a part worth 1 to 6, which is weak: laws should stay undecided,
the true one among them. A row per truth; writes results/laws.json, which holds what was done when it is run again.
"""

import itertools
import sys
from collections.abc import Iterator

import numpy as np
from study import RESULTS, Found, command, say, show, store, stored, timed

import dropper_jax as dj
from fitting import Convention, Trace, compare, prepare
from fitting.calibration.decision import verdict
from fitting.calibration.law_fits import LADDER, PARTS

RATE, NOISE, FINE, WINDOW = 60.0, 5e-4, 32, 1.4
#: Watched for [s]: one link shows laws by one amplitude alone, as it falls.
DURATION = {1: 24.0, 2: 12.0, 3: 12.0, 7: 12.0}
#: What a part of a weak truth is worth in log likelihood, and most noise [rad].
WEAK, MOST = (1.0, 6.0), 0.1
#: Log likelihood that leaving a part out must cost for the part to be strong.
STRONG = 10.0
#: Coefficients at which each part alone takes about half of the energy in the time watched, of a chain of 0.6 m and
#: 0.3 kg.
SIZES = {"linear": 0.02, "quadratic": 0.02, "joint viscous": 4e-3, "dry": 6e-3}


def chain(links: int, values: dict[str, float]) -> Found:
    """The scene with the coefficients of these parts."""
    effects: Found = {"weight": {}}
    for part, value in values.items():
        _, effect, field = PARTS[part].split(".")
        effects.setdefault(effect, {})[field] = value
    if "joint_friction" in effects:
        effects["joint_friction"]["axis"] = [0.0, 1.0, 0.0]
    line = {"name": "chain", "from": "top", "to": "low", "links": links, "length": 0.6 / links, "mass": 0.3 / links}
    angles = [1.1 - 0.5 * j / max(links - 1, 1) for j in range(links)]
    return {
        "run": {"dt": 1 / RATE / FINE, "duration": DURATION[links], "save_every": FINE},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "low", "kind": "free", "position": [0.6, 0.0, 0.0]},
        ],
        "line": [line],
        "effects": effects,
        "start": {"kind": "angles", "zero": "down", "polar": angles},
    }


def watched(run, noise: str, rng: np.random.Generator, size: float = NOISE) -> Trace:
    """The run as a trace, with white noise or noise that remembers 0.8 of itself, of deviation `size` [rad]."""
    d = np.diff(run.positions, axis=1)
    angle = np.unwrap(np.arctan2(d[..., 0], -d[..., 2]), axis=0)
    e = rng.standard_normal(angle.shape)
    if noise == "filtered":
        for i in range(1, len(e)):
            e[i] = 0.8 * e[i - 1] + 0.6 * e[i]
    return Trace("chain", run.t, angle + size * e, convention=Convention("down", 1, "rad"))


def show_counts(rows: list[Found]) -> None:
    """The rows counted, as docs/statistics-of-fits.md has them."""
    show("links", "right law alone", "right law possible", "weak parts: right law possible", "of these undecided")
    for links in sorted({row["links"] for row in rows}):
        weak = [row for row in rows if row["links"] == links and row["weak"]]
        strong = [row for row in rows if row["links"] == links and row["strong"] and not row["weak"]]
        alone, inside = (sum(row[key] for row in strong) for key in ("alone", "inside"))
        possible = [row["alone"] for row in weak if row["inside"]]
        counts = (f"{alone} of {len(strong)}", inside, f"{len(possible)} of {len(weak)}", possible.count(False))
        show(links, *counts)


def one(links: int, law: str, trace: Trace) -> Found:
    """One trace compared."""
    scene = chain(links, dict.fromkeys(("linear", "quadratic"), 0.01))
    laws, times = timed(lambda: compare(prepare(trace, scene, ["b_l", "b_q"], window=WINDOW)))
    by_name = {other: row for row in laws for other in (row.name, *row.equals)}
    truth = by_name[law]
    poorer = [by_name[o] for o in LADDER if set(LADDER[o]) < set(LADDER[law]) and by_name[o].name != truth.name]
    cost = min((row.cost - truth.cost for row in poorer), default=np.inf)
    found = {
        "verdict": verdict(laws), "strong": bool(cost >= STRONG), "cost_of_a_part": float(cost),
        "alone": truth.possible and sum(row.possible for row in laws) == 1, "inside": truth.possible,
        "refuted": truth.refuted, "seconds": times["processor_s"],
    }  # fmt: skip
    say(found)
    return found


LAWS = [law for law, parts in LADDER.items() if 1 <= len(parts) <= 2]


def traces(links: int, law: str, draw: int, noises: list[str], rows: list[Found]) -> Iterator[tuple[Found, Trace]]:
    """Traces of one motion that are not among the rows, each with the head of its row.

    The noise of a weak one follows from what a part costs in the strong one, whose row must be added before the next
    trace is taken.
    """
    index = LAWS.index(law) + 1
    rng = np.random.default_rng([links, index, draw])
    values = {part: SIZES[part] / len(LADDER[law]) * rng.uniform(0.7, 1.4) for part in LADDER[law]}
    run = dj.simulate(chain(links, values))
    if run.status not in ("ok", "energy_drift"):
        sys.exit(f"{law}: {run.failure}")
    for k, noise in enumerate(noises):
        size, cost = NOISE, np.inf
        for weak in (False, True)[: 1 if draw or links > 2 or len(LADDER[law]) < 2 else 2]:
            name = {"links": links, "law": law, "draw": draw, "noise": noise, "weak": weak}
            rng = np.random.default_rng([links, index, draw, k, int(weak)])
            if weak:
                size = NOISE * float(np.sqrt(cost / rng.uniform(*WEAK)))
            if size > MOST:
                continue
            if not any(name.items() <= row.items() for row in rows):
                yield {**name, "values": values, "sigma": size}, watched(run, noise, rng, size)
            cost = next(row["cost_of_a_part"] for row in rows if name.items() <= row.items())


@command(links=[1, 2, 3, 7], laws=LAWS, draws=2, noise=["white", "filtered"], out=RESULTS / "laws.json")
def main(args) -> None:
    rows = stored(args.out, [])
    for links, law, draw in itertools.product(args.links, args.laws, range(args.draws)):
        for head, trace in traces(links, law, draw, args.noise, rows):
            rows.append({**head, **one(links, law, trace)})
            store(args.out, rows)
    show_counts(rows)
