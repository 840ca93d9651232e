"""Random longlines at rest: how many static poses are found, whether they balance and stay, and where runs end.

    python benchmarks/layouts.py [--count 300] [--first 0] [--only SEED ...] [--check 30] [--out results/layouts.json]

Layout i is drawn from seed i: a topology, a bed (flat, sloping, with hills), ropes and chains from floating to heavy,
lengths from taut to slack, floats and spar buoys from too small to much too large, depths of 5 to 60 m, currents of 0
to 2 m/s. Prints a row for each that is not found, and the share that is.

- Balance: forces of the effects and `EA max(e, 0)` of every link, summed anew in NumPy, over the weight of all lines.
- Stability: least real part of the eigenvalues of the whole stiffness, drag included (a pose to which every slow
  motion returns), over the weight of a mean link per its length. What nothing holds has zero.
- Check: a run with added damping from a pose pushed aside by up to 2 % of the size. Largest distance at its end over
  the length of the line, and largest difference of tensions over the largest tension; the smaller of them counts, as
  slack lines may lie in many ways and carry the same.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import dropper_jax as dj
from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from dropper_jax.run.solution import jsonable
from dropper_jax.statics import rest

#: Largest unbalanced force, and most negative stiffness, of a pose that counts as found; largest misfit of a check.
BALANCED, STABLE, SAME = 1e-8, -1e-6, 0.01
#: Of added damping [kg/s per kg], and how long checks run [s], at which step.
DAMPING, DURATION, STEP = 0.5, 240.0, 0.05

Scene = dict[str, Any]


class Bed:
    """A flat bed, a slope, or a slope with hills: depths of a grid and the height under a place."""

    KNOTS = 5

    def __init__(self, draw: np.random.Generator, depth: float, reach: float, flat: bool) -> None:
        self.flat, self.depth = flat, depth
        self.x = np.linspace(-reach, reach, self.KNOTS)
        slope, course = draw.uniform(0.0, 0.2), draw.uniform(0.0, 2 * np.pi)
        hills = draw.choice([0.0, 0.15]) * depth
        x, y = np.meshgrid(self.x, self.x, indexing="ij")
        depths = depth + slope * (x * np.cos(course) + y * np.sin(course)) + hills * draw.uniform(-1, 1, x.shape)
        self.depths = np.maximum(depths, 0.4 * depth)

    def height(self, x: float, y: float) -> float:
        if self.flat:
            return -self.depth
        i, j = (int(np.clip(np.searchsorted(self.x, v) - 1, 0, self.KNOTS - 2)) for v in (x, y))
        a, b = (float((v - self.x[k]) / (self.x[k + 1] - self.x[k])) for v, k in ((x, i), (y, j)))
        d = self.depths
        low, high = (1 - b) * d[i, j] + b * d[i, j + 1], (1 - b) * d[i + 1, j] + b * d[i + 1, j + 1]
        return -float((1 - a) * low + a * high)

    @property
    def deepest(self) -> float:
        return self.depth if self.flat else float(np.max(self.depths))

    def effect(self) -> Scene:
        if self.flat:
            return {"depth": self.depth}
        knots = self.x.tolist()
        return {"bed_x": knots, "bed_y": knots, "bed_depth": self.depths.ravel().tolist()}


class Layout:
    """A scene that grows: points, lines and buoys with numbers drawn on the way."""

    def __init__(self, seed: int, flat: bool) -> None:
        self.draw = draw = np.random.default_rng(seed)
        self.depth = float(np.exp(draw.uniform(np.log(5.0), np.log(60.0))))
        self.span = float(draw.uniform(0.8, 2.0) * max(self.depth, 15.0))
        self.bed = Bed(draw, self.depth, 3.0 * (self.span + self.depth), flat)
        self.types: list[Scene] = []
        self.points: list[Scene] = []
        self.lines: list[Scene] = []
        self.buoys: list[Scene] = []

    def between(self, low: float, high: float) -> float:
        """Evenly in the logarithm."""
        return float(np.exp(self.draw.uniform(np.log(low), np.log(high))))

    def kind(self, kind: str) -> Scene:
        """A rope that floats or sinks, a chain, or a sock full of mussels, of some thickness."""
        if kind == "any":
            kind = str(self.draw.choice(["floating", "sinking", "chain"]))
        if kind == "chain":
            bar = self.between(0.01, 0.04)
            mass, diameter, EA, cdn = 19.9e3 * bar**2, 1.8 * bar, 0.854e11 * bar**2, 1.4
        else:
            low, high = {"floating": (900, 1000), "sinking": (1050, 1400), "sock": (1100, 1500)}[kind]
            diameter = self.between(0.1, 0.25) if kind == "sock" else self.between(0.014, 0.08)
            area = 0.25 * np.pi * diameter**2
            mass = self.draw.uniform(low, high) * area
            EA = self.between(2e8, 5e9) * (0.25 * np.pi * min(diameter, 0.03) ** 2)
            cdn = 1.2
        name = f"{kind}-{len(self.types)}"
        rest = {"damping_ratio": 0.5, "cdn": cdn, "cdt": 0.02, "can": 1.0, "cat": 0.0}
        self.types.append({"name": name, "mass": float(mass), "diameter": float(diameter), "EA": float(EA), **rest})
        return self.types[-1]

    def anchor(self, name: str, x: float, y: float = 0.0) -> str:
        self.points.append({"name": name, "position": [x, y, self.bed.height(x, y)]})
        return name

    def held(self, name: str, x: float, z: float) -> str:
        self.points.append({"name": name, "position": [x, 0.0, max(z, self.bed.height(x, 0.0))]})
        return name

    def free(self, name: str, x: float, z: float, y: float = 0.0, volume: float = 0.0, mass: float = 0.0) -> str:
        point = {"name": name, "kind": "free", "position": [x, y, max(z, 0.95 * self.bed.height(x, y))]}
        if volume or mass:
            frontal = 0.25 * np.pi * (6.0 * volume / np.pi) ** (2.0 / 3.0)
            point |= {"mass": mass or 80.0 * volume, "volume": volume, "drag_area": float(0.5 * frontal + 1e-3)}
        self.points.append(point)
        return name

    def spar(self, name: str, x: float, lift: float) -> str:
        """A buoy that can carry about `lift` [N]."""
        self.free(name, x, -1.0)
        diameter = self.between(0.4, 1.0)
        area = 0.25 * np.pi * diameter**2
        height = float(np.clip(1.5 * lift / (1025.0 * 9.81 * area), 1.0, 10.0))
        mass = float(0.35 * 1025.0 * area * height)
        self.buoys.append(
            {"name": f"buoy-{name}", "point": name, "mass": mass, "diameter": diameter, "height": height}
            | {"cdn": 0.8, "cdt": 0.4}
        )
        return name

    def place(self, name: str) -> np.ndarray:
        return np.array(next(p for p in self.points if p["name"] == name)["position"])

    def line(self, name: str, start: str, end: str, kind: Scene, links: int, length: float, **more: Any) -> None:
        table = {"name": name, "from": start, "to": end, "type": kind["name"], "length": length, "links": links}
        self.lines.append(table | more)

    def mooring(self, name: str, anchor: str, end: str, links: int) -> None:
        """Anchor to float, from nearly taut to twice as long."""
        length = float(np.linalg.norm(self.place(anchor) - self.place(end))) * self.draw.uniform(1.01, 2.0)
        self.line(name, anchor, end, self.kind("any"), links, length)

    def lift(self, kind: Scene, length: float) -> float:
        """What a float must carry to hold up that much of a line [N]; that of a metre of water at least."""
        wet = kind["mass"] - 1025.0 * 0.25 * np.pi * kind["diameter"] ** 2
        return 9.81 * max(wet * length, 5.0)

    def scene(self, name: str) -> Scene:
        draw = self.draw
        speed = float(draw.choice([0.0, 1.0]) * draw.uniform(0.0, 2.0))
        current = {"kind": "power", "speed": speed, "direction": float(draw.uniform(0, 2 * np.pi))}
        return {
            "name": name,
            "run": {"dt": STEP, "duration": DURATION},
            "line_type": self.types,
            "point": self.points,
            "line": self.lines,
            **({"buoy": self.buoys} if self.buoys else {}),
            "sea": {"depth": self.bed.deepest, "current": current | {"exponent": float(draw.choice([0.0, 1.0 / 7.0]))}},
            "effects": {
                "weight": {},
                "buoyancy": {},
                "morison_drag": {},
                "morison_inertia": {},
                "seabed": self.bed.effect(),
            },
        }


def rope(at: Layout) -> None:
    """One rope between two held points, somewhere from the bed to the surface."""
    ends = [at.held(name, x, -at.depth * at.draw.uniform(-0.05, 1.0)) for name, x in (("a", 0.0), ("b", at.span))]
    length = float(np.linalg.norm(at.place("a") - at.place("b"))) * at.draw.uniform(0.995, 1.6)
    at.line("rope", *ends, at.kind("any"), 30, length)


def single(at: Layout) -> None:
    """A spar at the end of a chain or rope, with a small float or a clump weight on the way."""
    at.anchor("anchor", 0.0)
    volume = at.between(0.005, 0.1) * at.draw.choice([0.1, 1.0])
    at.free("middle", 0.4 * at.span, -0.5 * at.depth, volume=volume, mass=at.between(5.0, 100.0))
    lower, upper = at.kind("any"), at.kind("any")
    at.spar("spar", at.span, at.lift(upper, 1.5 * at.depth) * at.between(0.8, 5.0))
    for name, ends, kind in (("lower", ("anchor", "middle"), lower), ("upper", ("middle", "spar"), upper)):
        size = float(np.linalg.norm(at.place(ends[0]) - at.place(ends[1])))
        at.line(name, *ends, kind, 12, size * at.draw.uniform(0.9, 1.7))


def backbone(at: Layout, floats: int) -> tuple[Scene, list[str]]:
    """Two moorings, a backbone between their ends, and floats along it at the surface or below; taut to slack."""
    deep = at.depth * at.draw.choice([0.02, 0.3])
    length = at.span * float(at.draw.uniform(0.98, 1.3))
    out = at.draw.uniform(0.8, 2.5) * at.depth
    west, east = at.anchor("west", -out), at.anchor("east", at.span + out)
    sock = at.kind("sock")
    for name, x in (("left", 0.0), ("right", at.span)):
        if at.draw.random() < 0.2:
            at.free(name, x, -deep, mass=5.0, volume=0.05)  # held up by nothing much
        else:
            at.free(name, x, -deep, volume=at.lift(sock, at.depth) / 9810.0 * at.between(0.7, 4.0))
    names = [f"f{i + 1}" for i in range(floats)]
    each = at.lift(sock, 0.7 * at.depth) / 9810.0
    for i, name in enumerate(names):
        at.free(name, at.span * (i + 1) / (floats + 1), -deep, volume=each * at.between(0.3, 4.0))
    at.mooring("west-leg", west, "left", 10)
    at.mooring("east-leg", "right", east, 10)
    attach = [{"point": name, "at": length * (i + 1) / (floats + 1)} for i, name in enumerate(names)]
    at.line("backbone", "left", "right", at.kind("any"), 4 * (floats + 1), length, attach=attach)
    return sock, names


def droppers(at: Layout) -> None:
    """A longline with droppers that hang freely, some down to the bed."""
    sock, names = backbone(at, 3)
    length = at.depth * float(at.draw.uniform(0.2, 1.1))
    for i, name in enumerate(names):
        x, _, z = at.place(name)
        at.free(f"end-{i + 1}", float(x), float(z) - length, mass=float(at.draw.choice([0.0, 10.0])) or 0.1)
        at.line(f"dropper-{i + 1}", name, f"end-{i + 1}", sock, 5, length)


def loops(at: Layout) -> None:
    """A longline with socks looped from float to float."""
    sock, names = backbone(at, 4)
    length = at.span / 5 * float(at.draw.uniform(1.2, 4.0))
    for i, (a, b) in enumerate(zip(names[:-1], names[1:], strict=True)):
        at.line(f"loop-{i + 1}", a, b, sock, 8, length)


def submerged(at: Layout) -> None:
    """A backbone under water, with ropes up to markers at the surface that may be slack, and a tie-down."""
    _, names = backbone(at, 3)
    for i, name in enumerate(names):
        x, _, z = at.place(name)
        volume = at.between(0.01, 0.3)
        at.free(f"marker-{i + 1}", float(x) + 0.2, -0.1, volume=volume)
        at.line(
            f"riser-{i + 1}", name, f"marker-{i + 1}", at.kind("any"), 4, (abs(z) + 0.5) * at.draw.uniform(0.9, 2.0)
        )
    anchor = at.anchor("middle", 0.5 * at.span)
    at.mooring("tie-down", anchor, "f2", 8)


def star(at: Layout) -> None:
    """A float in the middle of seven lines: five moorings, a dropper, and a rope to another float."""
    total = 0.0
    for i in range(5):
        angle, out = 2 * np.pi * (i + at.draw.uniform(-0.3, 0.3)) / 5, at.depth * at.draw.uniform(0.5, 2.0)
        at.anchor(f"anchor-{i + 1}", out * np.cos(angle), out * np.sin(angle))
    at.free("hub", 0.0, -0.3)
    for i in range(5):
        at.mooring(f"leg-{i + 1}", f"anchor-{i + 1}", "hub", 8)
        total += at.lift(at.types[-1], at.depth)
    sock = at.kind("sock")
    size = at.depth * float(at.draw.uniform(0.3, 0.9))
    at.points[5] |= {"mass": 50.0, "volume": (total + at.lift(sock, size)) / 9810.0 * at.between(0.6, 3.0)}
    at.points[5] |= {"drag_area": 0.3}
    at.free("end", 0.0, -size, mass=1.0)
    at.line("dropper", "hub", "end", sock, 6, size)
    at.free("tail", 10.0, -0.1, volume=at.between(0.005, 0.2))
    at.line("towed", "hub", "tail", at.kind("any"), 6, 10.0 * at.draw.uniform(0.9, 1.5))


TOPOLOGIES: tuple[Callable[[Layout], None], ...] = (rope, single, droppers, loops, submerged, star)


def layout(seed: int) -> Scene:
    """The plain values of layout `seed`."""
    topology = TOPOLOGIES[seed % len(TOPOLOGIES)]
    at = Layout(seed, flat=seed // len(TOPOLOGIES) % 2 == 0)
    topology(at)
    return at.scene(f"{topology.__name__}-{seed}")


def unbalanced(model: dj.Model, s: dj.State) -> np.ndarray:
    """Forces that are left on the free nodes (free, 3) [N], the ropes' tensions anew from where their ends are."""
    k = model.instant(s.r, jnp.zeros_like(s.r), s.t)
    total = np.array(model.force(k))
    graph, line = model.geometry, model.line
    field = np.concatenate([np.asarray(s.r), np.asarray(model.ends(s.t).places)])
    length, EA = np.asarray(line.length), np.asarray(line.axial.EA)
    for first, last, size, stiffness in zip(graph.first, graph.last, length, EA, strict=True):
        d = field[last] - field[first]
        now = np.linalg.norm(d)
        if now <= size:
            continue
        pull = stiffness * (now / size - 1.0) * d / now
        for node, force in ((first, pull), (last, -pull)):
            if node < graph.free:
                total[node] += force
    return total


@jax.jit
def stiffness(model: dj.Model, s: dj.State) -> jax.Array:
    """How all forces fall with all places (3 free, 3 free) [N/m]."""

    def forces(r: jax.Array) -> jax.Array:
        d = model.links(r, model.ends(s.t))
        pull = model.line.axial.tension(d, jnp.zeros_like(d), model.line.length)
        away = model.pull(pull, model.line.axial.direction(d, d, d, model.line.length))
        return -(model.force(model.instant(r, jnp.zeros_like(r), s.t)) + away).ravel()

    return jax.jacfwd(lambda x: forces(x.reshape(s.r.shape)))(s.r.ravel())


def judged(seed: int) -> Scene:
    """Layout `seed` solved: what `dj.equilibrium` says, balance and stability of the pose, and the time it took."""
    begin = time.perf_counter()
    found: Scene = {"seed": seed, "name": layout(seed)["name"]}
    try:
        scene = dj.load_scene(layout(seed))
        pose = dj.equilibrium(scene)
    except SceneError as error:
        return found | {"ok": False, "why": f"refused: {error}"}
    found["seconds"] = time.perf_counter() - begin
    model = rest(dj.run.build.build_model(scene))
    link = 9.81 * float(jnp.mean(model.line.mass))
    s = pose.state
    found["residual"] = float(np.max(np.abs(unbalanced(model, s)))) / (9.81 * float(jnp.sum(model.line.mass)))
    values = np.linalg.eigvals(np.asarray(stiffness(model, s)))
    found["stiffness"] = float(np.min(values.real)) / (link / float(jnp.mean(model.line.length)))
    reasons = [] if pose.status == "ok" else [pose.message]
    reasons += [] if found["residual"] <= BALANCED else ["out of balance"]
    reasons += [] if found["stiffness"] >= STABLE else ["not stable"]
    return found | {"ok": not reasons, "why": "; ".join(reasons)}


run = jax.jit(dj.integrate, static_argnames=("stepper", "steps", "save_every"))


def checked(seed: int) -> Scene:
    """Misfits of a pose and the end of a damped run that begins beside it."""
    scene = dj.load_scene(layout(seed))
    pose = dj.equilibrium(scene)
    model = dj.run.build.build_model(scene)
    damping = dj.effects.LinearDamping(b_l=DAMPING * model.node_mass)
    model = replace(model, effects=(*model.effects, damping))
    size = float(np.max(np.ptp(pose.positions, axis=0)))
    r = pose.state.r
    bow = np.sin(np.pi * np.asarray(r) / size + np.arange(3)) * 0.02 * size
    start = dj.state(model, r + jnp.asarray(bow), tension=pose.state.tension)
    stepper = dj.make_stepper(model, "energy_momentum", "network", track_work=False)
    steps = round(DURATION / STEP)
    end, path = run(stepper, model, start, STEP, steps, save_every=steps // 10)
    longest = max(float(np.sum(line.length)) for line in scene.lines)
    moved = float(np.max(np.abs(np.asarray(end.r - r)))) / longest
    most = max(float(np.max(pose.tension)), 9.81 * float(jnp.mean(model.line.mass)))
    pulled = float(np.max(np.abs(np.asarray(end.tension) - pose.tension))) / most
    return {"moved": moved, "pulled": pulled, "failed": int(np.sum(path.failed)), "same": min(moved, pulled) <= SAME}


def write(path: Path | None, rows: list[Scene]) -> None:
    """The rows so far."""
    if path is not None:
        atomic_write(path, json.dumps(jsonable({"rows": rows}), indent=1) + "\n")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="*", help="seeds")
    parser.add_argument("--check", type=int, default=0, help="how many poses to compare with damped runs")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    seeds = args.only or range(args.first, args.first + args.count)
    print("| layout | residual | stiffness | s | why |\n| --- | --- | --- | --- | --- |", flush=True)
    rows = []
    # layouts of one topology and one kind of bed share their programs
    for seed in sorted(seeds, key=lambda i: (i % (2 * len(TOPOLOGIES)), i)):
        rows.append(row := judged(seed))
        if not row["ok"] or args.only:
            numbers = " | ".join(f"{row.get(key, np.nan):.1e}" for key in ("residual", "stiffness", "seconds"))
            print(f"| {row['name']} | {numbers} | {row['why']} |", flush=True)
        write(args.out, rows)
    good = [row for row in rows if row["ok"]]
    print(f"found: {len(good)} of {len(rows)}, {len(good) / len(rows):.1%}")
    # evenly over topologies and beds, one after another as they stand
    for row in good[:: max(len(good) // args.check, 1)][: args.check] if args.check else ():
        row |= checked(row["seed"])
        print(f"| {row['name']} | moved {row['moved']:.1e} | pulled {row['pulled']:.1e} | {row['same']} |", flush=True)
        write(args.out, rows)
    return int(len(good) < 0.99 * len(rows))


if __name__ == "__main__":
    sys.exit(main())
