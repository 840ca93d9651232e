"""Six decks in CableDyn, MoorDyn v2 and here: tensions at rest, statistics of 60 s, processor time at equal error.

    python benchmarks/cabledyn_decks.py [--only NAME]

Needs the extra `peers`; takes about 10 minutes. Writes results/cabledyn.json.

All three read the deck that is written of one scene. MoorDyn and this program give the tension of the end links,
CableDyn the force at the end: means and maxima differ by half a link's weight (`half_link`), deviations do not.
Errors are each code's own, against a much smaller step; its time is that of the longest step within `LIMITS` whose
shorter ones are within them too.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

import re
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from moordyn_runs import SAMPLE, Looks, Ours, Rows, case, rows_of, theirs
from moordyn_speed import HARD, RAMP, SMOOTH, SPAN, driven, driven_chain
from study import Found, collect, command, describe, say, timed, versions

from dropper_jax import Scene, equilibrium, write_moordyn
from dropper_jax.run.growth import end_forces

SETTLED = 20.0  # [s]
LINKS = 12
SURGE = (10.0, 2.0, 0.0)
LIMITS = {"mean": 2e-3, "std": 1e-2}
#: Steps [s], the last of each is the reference.
CABLEDYN = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
MOORDYN = (0.0015, 0.001, 0.0007, 0.0005, 0.0003, 0.0001)
OURS = (1, 2, 5, 10, 20, 40, 160)  # steps in 0.1 s


def chain(motion: tuple[float, float, float], **sea) -> Scene:
    """The driven chain, from rest, with other values of the sea."""
    table = driven_chain(case(1), motion).with_values({"effects.end_motion.ramp": RAMP}).to_dict()
    return Scene.from_dict({**table, "sea": table["sea"] | sea})


def bridle() -> Scene:
    """Two chains from the seabed to a float, a third from there to the driven top."""
    table = chain(SMOOTH).to_dict()
    for values in table["effects"].values():  # one number for the links of all lines
        lists = [key for key, value in values.items() if isinstance(value, list) and len(value) == LINKS]
        values.update({key: values[key][0] for key in lists})
    (chain_,) = table["line"]

    def line(name: str, start: str, length: float, **more) -> Found:
        return {**chain_, "name": name, "from": start, "length": length / LINKS, "mass": 10.91 * length / LINKS, **more}

    legs = [line(f"leg-{side}", f"anchor-{side}", 40.0, to="float") for side in "ab"]
    float_ = {"name": "float", "position": [14.0, 0.0, -12.0], "kind": "free", "mass": 100.0, "volume": 0.5}
    anchors = [{"name": f"anchor-{side}", "position": [-10.0, y, -30.0]} for side, y in (("a", -12.0), ("b", 12.0))]
    table["point"] = [*anchors, float_, table["point"][1]]
    table["line"] = [line("pennant", "float", 20.0), *legs]
    return Scene.from_dict({**table, "name": "bridle"})


#: Across the chain's plane.
CURRENT = {"kind": "uniform", "speed": 1.0, "direction": 0.5 * np.pi}
DECKS: dict[str, tuple[Callable[[], Scene], tuple[float, float, float]]] = {
    "chain on the seabed, smooth": (partial(chain, SMOOTH), SMOOTH),
    "chain on the seabed, surging": (partial(chain, SURGE), SURGE),
    "chain on the seabed, snapping": (partial(chain, HARD), HARD),
    "chain hanging free": (partial(chain, SMOOTH, depth=100.0), SMOOTH),
    "chain in a current": (partial(chain, SURGE, current=CURRENT), SURGE),
    "bridle with a float": (bridle, SMOOTH),
}


def cabledyn_deck(scene: Scene, folder: Path, dt: float) -> Path:
    """The scene's deck with CableDyn's names of options, and a duration, which it asks for."""
    deck = folder / "mooring.txt"
    write_moordyn(scene, deck, dt=dt, options={"TMax": SPAN})
    lines = ["--------------------- CableDyn Input File ---------------------", *deck.read_text().splitlines()[1:]]
    named = (re.sub(" rho$", " rhoW", line) for line in lines if not line.endswith(" dtOut"))
    deck.write_text("\n".join(named) + "\n")
    return deck


def in_cabledyn(scene: Scene, place: Callable[[float], np.ndarray], dt: float) -> tuple[np.ndarray, Rows]:
    """Tensions (2,) of anchor and fairlead at rest [N], and the run.

    The top's velocity and acceleration are central differences of its place: they agree to 1e-6.
    """
    from cabledyn.model import CableDyn

    h = 1e-3
    with tempfile.TemporaryDirectory() as folder, CableDyn(cabledyn_deck(scene, Path(folder), dt)) as model:
        q = model.get_coupled_motion()[0].copy()
        v, a = np.zeros_like(q), np.zeros_like(q)
        kinds = [kind for _, kind in model.coupled_layout()]
        top = 3 * kinds.index("coupled") + np.arange(3)
        ends = ["AnchTen1", "FairTen1"]
        if "free" in kinds:  # from a free point to a driven one CableDyn counts the first end as the fairlead
            ends.reverse()
        rest = np.array(model.channels(ends))
        rows, cpu = [], 0.0
        for i in range(round(SPAN / dt)):
            t = (i + 1) * dt
            q[top] = place(t)
            v[top] = (place(t + h) - place(t - h)) / (2 * h)
            a[top] = (place(t + h) - 2 * place(t) + place(t - h)) / h**2
            cpu += timed(partial(model.step, dt, q, v, a))[1]["processor_s"]
            rows.append(model.channels(ends))
    t = np.round(dt * np.arange(1, len(rows) + 1), 9)
    seen = Looks(t, np.array(rows), np.zeros((len(rows), 1, 3)), cpu, "ok")
    return rest, rows_of(seen, max(1, round(SAMPLE / dt)))


def statistics(rows: Rows) -> Found:
    found = rows.statistics(SETTLED)
    return {end: {key: found[end][key] for key in ("mean", "std", "max")} for end in ("anchor", "fairlead")}


def cheapest(steps: tuple, run: Callable) -> Found:
    """Statistics of the smallest step, and the longest step within the limits, with its time [s per s]."""
    last = run(steps[-1])
    if last.status != "ok":
        return {"statistics": None, "best": None, "status": last.status}
    reference, best = statistics(last), None
    for step in reversed(steps[:-1]):
        rows = run(step)
        if rows.status != "ok":
            break
        found = statistics(rows)["fairlead"]
        errors = {key: abs(found[key] / reference["fairlead"][key] - 1.0) for key in LIMITS}
        if not all(errors[key] <= limit for key, limit in LIMITS.items()):
            break
        best = {"step": step, "errors": errors, "cpu_per_s": rows.cpu_s / SPAN}
        say(best)
    return {"statistics": reference, "best": best, "status": "ok"}


def compare(name: str) -> Found:
    made, motion = DECKS[name]
    scene, place = made(), driven(motion, ramp=RAMP)
    ours = Ours.of(scene)
    rest, _ = in_cabledyn(scene, place, CABLEDYN[1])
    pose = equilibrium(ours.model)
    forces = end_forces(scene, np.asarray(pose.positions)[None], np.asarray(pose.tension)[None])
    own = forces[scene.lines[0].name][0]
    return {
        "name": name,
        "at_rest": {"cabledyn": rest.tolist(), "ours": own.tolist()},
        "half_link": (own - np.asarray(ours.start.tension)[[0, LINKS - 1]]).tolist(),
        "cabledyn": cheapest(CABLEDYN, lambda dt: in_cabledyn(scene, place, dt)[1]),
        "moordyn": cheapest(MOORDYN, lambda dt: theirs(scene, dt, SPAN, look=0.01, drive=place, call=0.001)),
        "ours": cheapest(OURS, lambda every: ours.run(every, SPAN, 2)),
    }


@command(only=(None, *DECKS))
def main(given) -> None:
    rows = (compare(name) for name in DECKS if given.only in (None, name))
    packages = versions("cabledyn", "moordyn", "jax", "dropper-jax", "numpy")
    collect("cabledyn", {"decks": rows}, by="name", schema=1, machine=describe(), versions=packages, limits=LIMITS)
