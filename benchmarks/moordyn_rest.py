"""Every packaged scene as a deck, in calm water at rest: end tensions in MoorDyn v2 against those of the scene and of
the deck as it is read here.

    python benchmarks/moordyn_rest.py [SCENE ...]

Needs the extra `moordyn`; takes about 20 minutes. Writes results/moordyn_rest.json and prints what it finds. Waves are
taken out of each scene, a steady current stays. Free points start where they rest here, lines by MoorDyn's own search;
it runs for 120 s. Floats that are partly above the water are fixed where they rest here.
"""

import contextlib
import tempfile
from pathlib import Path

import numpy as np
from moordyn_point import quiet
from study import Found, collect, command, versions

from dropper_jax import Scene, SceneError, equilibrium, load_scene, scene_names, write_moordyn
from dropper_jax.moordyn.writing.differences import moved_points
from dropper_jax.scene.data import point_nodes
from dropper_jax.statics.search import Equilibrium

#: Time that MoorDyn runs [s], and the speed [m/s] below which its nodes count as at rest.
SPAN, AT_REST = 120.0, 1e-3
#: MoorDyn's step over the shortest time that a pulse takes along a link, and the largest step [s].
PART, LARGEST_STEP = 0.3, 1e-3
#: More drag, on which a pose at rest in still water does not depend: a spar's heave would fade as 1/t.
DRAG = 20.0
#: Difference of end tensions above which the worst line is compared alone: times its links, and MoorDyn's time [s].
CLOSE, FINER, BRIEF = 0.01, (1, 2, 4, 8), 40.0
#: Points this far [m] above their own rest are out of the water: MoorDyn's volume of a point stays wet, ours does not.
DRY = 0.1
#: Tensions below this part of the deck's largest are compared with that part.
LEAST = 1e-2


def calm(name: str) -> Scene:
    """A packaged scene without waves and what follows them; in still water with more drag."""
    values = load_scene(name).to_dict()
    values["start"] = {"kind": "static"}
    sea = values.get("sea", {})
    for key in ("waves", "ramp"):
        sea.pop(key, None)
    for key in ("time", "factor"):  # a current that changes in time is written, and rests, at its speed
        sea.get("current", {}).pop(key, None)
    values["effects"].pop("sea_following_end", None)
    if "current" not in sea:
        _more_drag(values)
    return Scene.from_dict(values)


def _more_drag(values) -> None:
    """Every drag coefficient times DRAG, wherever it is."""
    for key, value in values.items() if isinstance(values, dict) else enumerate(values):
        if key in ("cdn", "cdt") and value is not None:
            values[key] = (DRAG * np.asarray(value)).tolist()
        elif isinstance(value, dict | list):
            _more_drag(value)


def rest_of(scene: Scene) -> Equilibrium:
    pose = equilibrium(scene)
    if pose.status != "ok":
        raise ArithmeticError(f"no pose at rest here: {pose.status}")
    return pose


def moved_to(scene: Scene, pose: Equilibrium) -> Scene:
    """The scene with its free points and bodies where they rest: a buoy's slow sway would outlast MoorDyn's run.

    Floats that are partly above the water there are fixed, because the volume of a point of MoorDyn's is always wet.
    """
    values, position = scene.to_dict(), {name: pose.positions[node] for name, node in point_nodes(scene).items()}
    for row in values["point"]:
        if row.get("kind") == "free" and row["name"] in position:
            row["position"] = position[row["name"]].tolist()
            if position[row["name"]][2] > -np.cbrt(0.75 / np.pi * (row.get("volume") or 0.0)):
                for key in row.keys() - {"name", "position"}:
                    del row[key]
    for body, row in zip(scene.bodies, values.get("body", []), strict=True):
        name = next(name for name in body.attachments if name in position)
        row["position"] = (body.position + position[name] - body.world(body.attachments[name])).tolist()
    return Scene.from_dict(values)


def largest_step(scene: Scene) -> float | None:
    """A step [s] at which MoorDyn's explicit scheme is stable on these lines; None of rigid ones."""
    if any(line.EA is None for line in scene.lines):
        return None
    times = [np.min(line.length * np.sqrt(line.mass / (line.length * line.EA))) for line in scene.lines]
    return float(f"{min(PART * min(times), LARGEST_STEP):.2g}")


def there(folder: Path, held: list[float], span: float = SPAN) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Links (lines,), end tensions (lines, 2) [N] in MoorDyn after `span` [s]; largest speed [m/s], height [m]."""
    import moordyn

    still = [0.0] * len(held)
    with contextlib.chdir(folder), quiet():
        system = moordyn.Create("deck.txt")
        try:
            moordyn.Init(system, held, still)
            moordyn.Step(system, held, still, 0.0, span)
            lines = [moordyn.GetLine(system, i + 1) for i in range(moordyn.GetNumberLines(system))]
            links = {line: moordyn.GetLineN(line) for line in lines}
            nodes = [(line, j) for line, count in links.items() for j in range(count + 1)]
            ends = [[moordyn.GetLineNodeTen(line, j) for j in (0, count)] for line, count in links.items()]
            speeds = [np.linalg.norm(moordyn.GetLineNodeVel(*node)) for node in nodes]
            heights = [moordyn.GetLineNodePos(*node)[2] for node in nodes]
        finally:
            moordyn.Close(system)
    return np.array(list(links.values())), np.linalg.norm(ends, axis=2), float(np.max(speeds)), float(np.max(heights))


def alone(scene: Scene, pose: Equilibrium, number: int, times: int) -> float:
    """Largest difference of a line's end tensions, the line alone between its ends' positions with finer links."""
    line = scene.lines[number]
    node, link = (sum(one.links + more for one in scene.lines[:number]) for more in (1, 0))
    kind = {"mass": line.mass[0] / line.length[0], "diameter": line.diameter[0], "EA": line.EA[0], "damping_ratio": 0.3}
    kind |= {key: np.broadcast_to(scene.effects["morison_drag"][key], scene.line.links)[link] for key in ("cdn", "cdt")}
    ends = {"a": pose.positions[node], "b": pose.positions[node + line.links]}
    row = {"name": "one", "from": "a", "to": "b", "type": "rope", "length": line.total, "links": times * line.links}
    values = {
        "run": {"dt": scene.run.dt, "duration": 1.0},
        "line_type": [{"name": "rope", **{key: float(x) for key, x in kind.items()}}],
        "point": [{"name": name, "position": position.tolist()} for name, position in ends.items()],
        "line": [row],
        "sea": scene.to_dict()["sea"],
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
        "start": {"kind": "static"},
    }
    single = load_scene(values)
    with tempfile.TemporaryDirectory() as folder:
        write_moordyn(single, Path(folder) / "deck.txt", dt=largest_step(single))
        theirs = there(Path(folder), [], BRIEF)[1]
    return float(np.max(np.abs(rest_of(single).tension[[0, -1]] / theirs[0] - 1.0)))


def compare(name: str) -> Found:
    """One scene: a status, and where MoorDyn's deck rests the largest difference of end tensions."""
    try:
        scene = calm(name)
        with tempfile.TemporaryDirectory() as where:
            folder, moved = Path(where), moved_points(scene)
            dt = largest_step(scene)
            write_moordyn(scene, folder / "deck.txt", dt=dt)  # refuses a scene before its pose is sought
            own = rest_of(scene)
            write_moordyn(moved_to(scene, own), folder / "deck.txt", dt=dt)
            deck = load_scene(folder / "deck.txt")
            held = [float(x) for point in scene.points if point.name in moved for x in point.position]
            counts, ends, speed, highest = there(folder, held)
            read = rest_of(deck)
    except (SceneError, ArithmeticError, RuntimeError) as error:
        return {"scene": name, "status": str(error)}
    past = np.cumsum(counts)
    own_ends = np.stack([past - counts, past - 1], axis=1)
    scale = np.maximum(ends, LEAST * np.max(ends))
    status = "ok" if speed < AT_REST else f"MoorDyn moves by {1e3 * speed:.2g} mm/s after {SPAN:g} s"
    if highest > DRY + max(float(np.max(own.positions[:, 2])), 0.0):
        status = f"floats leave the water in MoorDyn, by {highest:.2g} m: the volume of a point stays wet there"
    apart, deck_apart = (np.abs(links[own_ends] - ends) / scale for links in (own.tension, read.tension))
    found = {
        "scene": name,
        "status": status,
        "dt_s": dt,
        "lines": len(counts),
        "speed": speed,
        "largest_n": float(np.max(ends)),
        "scene_difference": float(np.max(apart)),
        "deck_difference": float(np.max(deck_apart)),
    }
    if status == "ok" and found["deck_difference"] > CLOSE:  # goes with finer links if it is the drag at bends
        worst = int(np.argmax(deck_apart)) // 2
        found["alone"] = [alone(scene, own, worst, times) for times in FINER]
    return found


def deck_of(name: str) -> str:
    """The deck of the calm scene without name and description, which scenes share; the name of a rejected scene."""
    try:
        scene = calm(name).with_values({"name": "deck", "description": ""})
        with tempfile.TemporaryDirectory() as folder:
            write_moordyn(scene, Path(folder) / "deck.txt", dt=largest_step(scene))
            return "".join(file.read_text() for file in sorted(Path(folder).iterdir()))
    except SceneError:
        return name


@command({"scenes": list(scene_names())})
def main(args) -> None:
    rows: dict[str, Found] = {}

    def row(name: str) -> Found:
        """That of an earlier scene with the same deck, if there is one."""
        deck = deck_of(name)
        if deck in rows:
            return {**rows[deck], "scene": name, "same_deck_as": rows[deck]["scene"]}
        rows[deck] = compare(name)
        return rows[deck]

    collect("moordyn_rest", {"rows": map(row, args.scenes)}, by="scene", versions=versions("moordyn", "dropper-jax"))
