"""Hard scenes as plain tables, as a user would write them. Names and numbers of links are equal if possible, so that
many scenes share one compiled program."""

from typing import Any

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import equilibrium

LINKS = 7
#: One packaged scene of each kind of line and effects, and all releases of the lab dropper.
SINGLE_LINES = (
    *("conical-pendulum", "conical-pendulum-damped", "double-pendulum-periodic", "double-pendulum-chaotic", "string"),
    *(f"dropper-release-{kind}" for kind in ("a", "a-undamped", "b", "c", "d", "e", "3d", "a-compound")),
)


def loop(
    name: str, width: float, length: Any = 0.1, mass: Any = 0.03, effects: dict[str, Any] | None = None, **start: Any
) -> Scene:
    """Seven links between two fixed points `width` [m] apart."""
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 10.0},
            "point": [
                {"name": "left", "position": [0.0, 0.0, 0.0]},
                {"name": "right", "position": [width, 0.0, 0.0]},
            ],
            "line": [
                {"name": "dropper", "from": "left", "to": "right", "links": LINKS, "length": length, "mass": mass}
            ],
            "effects": {"weight": {}, **(effects or {})},
            "start": {"kind": "static", **start},
        }
    )


def single_line(
    length: Any,
    mass: Any,
    start: dict[str, Any],
    right: list[float] | None = None,
    effects: dict[str, Any] | None = None,
    dt: float = 0.01,
    duration: float = 1.0,
    **line: Any,
) -> dict[str, Any]:
    """A line of links of these lengths [m] from `left` to `right`, which is a free end unless its place is given."""
    length = [float(x) for x in length]
    far = [sum(length), 0.0, 0.0] if right is None else right
    ends = {"name": "line", "from": "left", "to": "right"}
    return {
        "run": {"dt": dt, "duration": duration},
        "point": [
            {"name": "left", "position": [0.0, 0.0, 0.0]},
            {"name": "right", "kind": "free" if right is None else "fixed", "position": far},
        ],
        "line": [{**ends, "links": len(length), "length": length, "mass": mass, **line}],
        "effects": {"weight": {}} if effects is None else effects,
        "start": start,
    }


def rods(
    polar: list[float], length: Any = 1.0, mass: Any = 1.0, effects: dict[str, Any] | None = None, **start: Any
) -> dict[str, Any]:
    """A chain from a pivot to a free tip, its links at polar angles [rad] from straight down, in air."""
    along = np.stack([np.sin(polar), np.zeros(len(polar)), -np.cos(polar)], axis=1)
    tip = np.broadcast_to(length, len(polar)) @ along
    return {
        "run": {"dt": 0.01, "duration": 10.0},
        "point": [
            {"name": "pivot", "position": [0.0, 0.0, 0.0]},
            {"name": "tip", "kind": "free", "position": tip.tolist()},
        ],
        "line": [{"name": "chain", "from": "pivot", "to": "tip", "links": len(polar), "length": length, "mass": mass}],
        "effects": {"weight": {}, **(effects or {})},
        "start": {"kind": "angles", "zero": "down", "polar": list(polar), **start},
    }


def chain(
    name: str, polar: list[float], length: float = 1.0, effects: dict[str, Any] | None = None, **start: Any
) -> Scene:
    """Links of 1 kg, with rates as in `[start]`."""
    table = {"name": name} | rods(polar, length, **start)
    return load_scene(table if effects is None else table | {"effects": effects})


def by_a_rope(body: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A body that no line holds; scenes have a line, which is far off."""
    rope = {"length": 2.0, "mass": 1.0, "diameter": 0.02, "axial": {"law": "rope", "EA": 1e4}}
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [{"name": "a", "position": [50.0, 0.0, -5.0]}, {"name": "b", "position": [53.0, 0.0, -5.0]}],
        "line": [{"name": "rope", "from": "a", "to": "b", "links": 2, **rope}],
        "body": [body],
        "effects": {"weight": {}},
        "start": {"kind": "points"},
        **more,
    }


def swing_period(t: np.ndarray, angle: np.ndarray) -> float:
    """Mean time [s] between falls of an angle through zero, linear between samples."""
    falls = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    return float(np.mean(np.diff(t[falls] + angle[falls] / (angle[falls] - angle[falls + 1]) * np.diff(t)[falls])))


def with_motion(scene: Scene, positions: np.ndarray, velocities: np.ndarray) -> Scene:
    """The scene started from all nodes' positions and velocities, each (n + 1, 3) [m], [m/s]."""
    table = scene.to_dict()
    table["start"] = {"kind": "positions", "positions": positions.tolist(), "velocities": velocities.tolist()}
    return Scene.from_dict(table)


def lifted_loop(name: str, width: float, force: float = 0.5, **more: Any) -> Scene:
    """A loop released from the equilibrium in which its third node is lifted and pulled aside by `force` [N]."""
    return loop(name, width, release_nodes=[3], release_force=[[0.1 * force, 0.1 * force, force]], **more)


def kicked_string(nodes: int = LINKS) -> Scene:
    """A string that hangs straight down, its tip kicked to 2 m/s out of the plane."""
    scene = chain("hanging-kicked", [0.0] * nodes, 0.1)
    positions = np.zeros((nodes + 1, 3))
    positions[:, 2] = -0.1 * np.arange(nodes + 1)
    speeds = np.zeros((nodes + 1, 3))
    speeds[-1] = [0.0, 2.0, 0.0]
    return with_motion(scene, positions, speeds)


def whirling(rate: float = 30.0) -> Scene:
    """A loop that rotates rigidly about the line through its ends at `rate` [rad/s]."""
    scene = loop("whirling-loop", 0.3)
    positions = equilibrium(scene).positions
    return with_motion(scene, positions, np.cross(np.array([rate, 0.0, 0.0]), positions))


def driven() -> Scene:
    """A loop whose right end moves across its plane with the period of its own swing about the line through the ends.

    Rigid rotation about this line is an exact motion of the loop: `w^2 = g sum(m z) / sum(m z^2)`.
    """
    depth = -equilibrium(loop("driven-at-resonance", 0.3)).positions[1:-1, 2]
    period = float(2 * np.pi * np.sqrt(np.sum(depth**2) / (GRAVITY * np.sum(depth))))
    motion = {"point": "right", "amplitude": [0.0, 0.02, 0.0], "period": period, "ramp": 2.0}
    return loop("driven-at-resonance", 0.3, effects={"end_motion": motion})


def thousand_links(links: int = 1000) -> Scene:
    """A loop of 100 m, pulled aside in its middle and released."""
    table = loop("thousand-links", 0.3).to_dict()
    table["point"][1]["position"] = [60.0, 0.0, 0.0]
    table["line"][0].update(links=links, length=100.0 / links, mass=100.0 / links)
    table["start"] = {"kind": "static", "release_nodes": [links // 2], "release_force": [[0.0, 20.0, 20.0]]}
    return Scene.from_dict(table)


G = GRAVITY
#: Depth of the seabed under weights on threads [m].
BED = 10.0
#: Of a thread: its length and diameter [m], whose product is twice the contact area of its end on the seabed.
THREAD, THICK = 30.0, 0.02
#: Diameter of a thread in the water [m], where others give it buoyancy.
THIN = 1e-4


def hung_weight(
    mass: float, rope: dict[str, Any], length: float, links: int = 1, below: float | None = None, **more: Any
) -> dict[str, Any]:
    """A weight [kg] below a point, on a line of a type `rope`; `below` [m]: its place if not that of the slack line."""
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [{"name": "rope", **rope}],
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "weight", "kind": "free", "position": [0.0, 0.0, -(below or length)], "mass": mass},
        ],
        "line": [{"name": "rope", "from": "top", "to": "weight", "type": "rope", "length": length, "links": links}],
        "effects": {"weight": {"gravity": G}},
        **more,
    }


def hung_line(links: int, length: Any, mass: Any, **line: Any) -> dict[str, Any]:
    """A line straight down from a point, its end free; `length` [m] and `mass` [kg] of a link, or of each."""
    down = float(np.sum(np.broadcast_to(length, links)))
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [0.0, 0.0, -down]},
        ],
        "line": [{"name": "rope", "from": "top", "to": "end", "links": links, "length": length, "mass": mass, **line}],
        "effects": {"weight": {}},
    }


def weight_on_rope(
    name: str,
    mass: float,
    stiffness: float,
    length: float,
    below: float,
    effects: dict[str, Any] | None = None,
    **more: Any,
) -> Scene:
    """A weight [kg] released `below` [m] its suspension point, on a light rope with a stiffness [N/m] and a length
    [m]."""
    kind = {"mass": 1e-6, "diameter": 0.01, "EA": stiffness * length}
    given = {"effects": {"weight": {"gravity": G}, **(effects or {})}, "start": {"kind": "points"}, **more}
    return load_scene({"name": name} | hung_weight(mass, kind, length, below=below, **given))


def weight_on_thread(
    name: str, body: dict[str, Any], position: list[float], effects: dict[str, Any], **more: Any
) -> Scene:
    """A body at a free point, connected by a slack weightless thread to a position above."""
    return load_scene(
        {
            "name": name,
            "run": {"dt": 0.01, "duration": 1.0},
            "line_type": [{"name": "thread", "mass": 1e-6, "diameter": THIN if "sea" in more else THICK, "EA": 1e3}],
            "point": [
                {"name": "tied", "position": [position[0], 0.0, 0.0]},
                {"name": "weight", "kind": "free", "position": position, **body},
            ],
            "line": [
                {"name": "thread", "from": "tied", "to": "weight", "type": "thread", "length": THREAD, "links": 1}
            ],
            "effects": {"weight": {"gravity": G}, **effects},
            "start": {"kind": "points"},
            **more,
        }
    )
