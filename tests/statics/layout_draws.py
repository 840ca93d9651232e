"""Random longlines: layout i is drawn from seed i (see `layouts.py`)."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import RegularGridInterpolator

#: How long checks run [s], at which step.
DURATION, STEP = 240.0, 0.05

#: Densities [kg/m3] and diameters [m] of ropes and socks.
ROPES = {
    "floating": ((900, 1000), (0.014, 0.08)),
    "sinking": ((1050, 1400), (0.014, 0.08)),
    "sock": ((1100, 1500), (0.1, 0.25)),
}

Scene = dict[str, object]


class Bed:
    """A flat bed, a slope, or a slope with hills: depths of a grid and the height under a place."""

    KNOTS = 5

    def __init__(self, draw: np.random.Generator, depth: float, reach: float, flat: bool) -> None:
        knots = np.linspace(-reach, reach, self.KNOTS)
        slope, course = draw.uniform(0.0, 0.2), draw.uniform(0.0, 2 * np.pi)
        hills = draw.choice([0.0, 0.15]) * depth
        x, y = np.meshgrid(knots, knots, indexing="ij")
        depths = depth + slope * (x * np.cos(course) + y * np.sin(course)) + hills * draw.uniform(-1, 1, x.shape)
        self.depths = np.maximum(depths, 0.4 * depth)
        self.effect: Scene = {"bed_x": knots.tolist(), "bed_y": knots.tolist()}
        self.effect["bed_depth"] = self.depths.ravel().tolist()
        if flat:
            self.depths, self.effect = np.full_like(depths, depth), {"depth": depth}
        self.between = RegularGridInterpolator((knots, knots), self.depths, bounds_error=False, fill_value=None)

    def height(self, x: float, y: float) -> float:
        return -float(self.between((x, y)))


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
        same = {"damping_ratio": 0.5, "cdn": 1.2, "cdt": 0.02, "can": 1.0, "cat": 0.0}
        if kind == "chain":
            bar = self.between(0.01, 0.04)
            own = {"mass": 19.9e3 * bar**2, "diameter": 1.8 * bar, "EA": 0.854e11 * bar**2, "cdn": 1.4}
        else:
            density, size = ROPES[kind]
            diameter = self.between(*size)
            mass = float(self.draw.uniform(*density) * 0.25 * np.pi * diameter**2)
            stiffness = self.between(2e8, 5e9) * (0.25 * np.pi * min(diameter, 0.03) ** 2)
            own = {"mass": mass, "diameter": diameter, "EA": float(stiffness)}
        self.types.append({"name": f"{kind}-{len(self.types)}", **same, **own})
        return self.types[-1]

    def anchor(self, name: str, x: float, y: float = 0.0, z: float = -np.inf) -> str:
        """A fixed point on the bed, or above it."""
        self.points.append({"name": name, "position": [x, y, max(z, self.bed.height(x, y))]})
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

    def line(self, name: str, start: str, end: str, kind: Scene, links: int, length: float, **more) -> None:
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
            "sea": {
                "depth": float(np.max(self.bed.depths)),
                "current": current | {"exponent": float(draw.choice([0.0, 1.0 / 7.0]))},
            },
            "effects": {
                "weight": {},
                "buoyancy": {},
                "morison_drag": {},
                "morison_inertia": {},
                "seabed": self.bed.effect,
            },
        }


def rope(at: Layout) -> None:
    """One rope between two held points, somewhere from the bed to the surface."""
    ends = [at.anchor(name, x, z=-at.depth * at.draw.uniform(-0.05, 1.0)) for name, x in (("a", 0.0), ("b", at.span))]
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
        at.free(f"marker-{i + 1}", float(x) + 0.2, -0.1, volume=at.between(0.01, 0.3))
        at.line(
            f"riser-{i + 1}", name, f"marker-{i + 1}", at.kind("any"), 4, (abs(z) + 0.5) * at.draw.uniform(0.9, 2.0)
        )
    at.mooring("tie-down", at.anchor("middle", 0.5 * at.span), "f2", 8)


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
