"""Eight films of known motion, tracked: order of the nodes, errors of the angles, standard errors, marks.

    python benchmarks/films.py [--films NAME ...]

The motion is that of point masses on rigid massless links in the plane, integrated by SciPy (DOP853) from equations of
its own, so that nothing of the simulator is in it: positions r, tensions from the twice differentiated lengths,

    m r'' = m g - c r' + J^T s,    J r'' = -J' r' - 2 a (J r') - a^2 (|d|^2 - L^2)/2,

with J the derivative of |d|^2/2 of each link and a = 60 1/s (Baumgarte). Each film is rendered with a bending lens and
tracked twice: with boards (lens and plane) and without anything. `tables.py` writes what is found into the page.
"""

import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from study import Found, command, say, store

from fitting.traces.synthetic import Motion
from fitting.tracking import track
from fitting.tracking.marks import find_marks
from fitting.tracking.ordering import AmbiguousOrderError
from fitting.tracking.render import Cover, View, chessboards, film
from fitting.tracking.video import opencv, write_video

FPS, GRAVITY, STABILISER = 60.0, 9.81, 60.0
#: Samples per frame of the motion that the renderer interpolates.
FINE = 8
#: Pictures of the board; noise of a centre where marks are tried [pixel]; largest error of an angle in the right order
#: [rad].
BOARDS, NOISE, RIGHT = 8, 0.05, 0.2


def closed(guess: np.ndarray, lengths: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The places (n, 2) nearest to a guess whose links have their lengths, `free` (n,) nodes moved (Gauss-Newton)."""
    places, move = np.array(guess, float), np.repeat(free, 2)
    for _ in range(50):
        jacobian, _ = _jacobian(places, np.zeros_like(places))
        short = 0.5 * (lengths**2 - np.sum(np.diff(places, axis=0) ** 2, axis=1))
        places.reshape(-1)[move] += np.linalg.lstsq(jacobian[:, move], short, rcond=None)[0]
    return places


def _jacobian(places: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (n - 1, 2 n) of |d|^2/2 by the places, and their rates times the rates of the places (n - 1,)."""
    link, j = np.diff(places, axis=0), np.arange(len(places) - 1)
    rows = np.zeros((len(j), len(places), 2))
    rows[j, j], rows[j, j + 1] = -link, link
    return rows.reshape(len(j), -1), np.sum(np.diff(rates, axis=0) ** 2, axis=1)


def point_masses(start: np.ndarray, loop: bool, t: np.ndarray, damping: float = 0.15) -> np.ndarray:
    """Places (k, n, 2) [m] at the times t (k,) [s] of unit masses let go at `start` (n, 2).

    Node 0 is held, in a loop the last one too.

    Args:
        damping: c/m [1/s].
    """
    nodes = len(start)
    lengths = np.linalg.norm(np.diff(start, axis=0), axis=1)
    free = np.ones(nodes, bool)
    free[0], free[-1] = False, not loop
    move = np.repeat(free, 2)
    weight = np.tile([0.0, -GRAVITY], nodes)[move]

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        places, speed = np.array(start, float), np.zeros((nodes, 2))
        places.reshape(-1)[move], speed.reshape(-1)[move] = np.split(y, 2)
        jacobian, turning = _jacobian(places, speed)
        jacobian, moving = jacobian[:, move], speed.reshape(-1)[move]
        off = 0.5 * (np.sum(np.diff(places, axis=0) ** 2, axis=1) - lengths**2)
        wanted = -turning - 2 * STABILISER * jacobian @ moving - STABILISER**2 * off
        force = weight - damping * moving
        tension = np.linalg.solve(jacobian @ jacobian.T, wanted - jacobian @ force)
        return np.concatenate([moving, force + jacobian.T @ tension])

    first = np.concatenate([np.array(start, float).reshape(-1)[move], np.zeros(move.sum())])
    found = solve_ivp(rates, (0.0, t[-1]), first, "DOP853", t_eval=t, rtol=1e-9, atol=1e-11)
    if not found.success:
        raise RuntimeError(f"films: the motion fails: {found.message}")
    places = np.tile(np.array(start, float), (len(t), 1, 1))
    places.reshape(len(t), -1)[:, move] = found.y[: move.sum()].T
    return places


@dataclass(frozen=True)
class Film:
    """What is filmed: chain or loop, `links` of 0.1 m, released after `rest` [s], and how."""

    name: str
    loop: bool
    view: View
    links: int = 4
    rest: float = 0.0
    duration: float = 3.0

    @property
    def nodes(self) -> int:
        return self.links + 1

    def motion(self) -> Motion:
        """Fine samples of the run, in the plane y = 0."""
        lengths = np.full(self.links, 0.1)
        turn = np.arange(self.links)
        if self.loop:
            span = np.linspace(0, 1, self.nodes)
            # pulled up and to the side: the low nodes swing through half the span
            guess = np.stack([0.056 * self.links * span, 0.05 - 0.25 * span * np.sin(np.pi * span**3)], axis=1)
            guess[[0, -1], 1] = 0.0
            free = (span > 0) & (span < 1)
            start = closed(guess, lengths, free)
        else:
            angle = np.deg2rad(-20 - 14.0 * turn)
            link = lengths[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            start = np.concatenate([np.zeros((1, 2)), np.cumsum(link, axis=0)])
        t = np.arange(round(self.duration * FPS) * FINE + 1) / (FPS * FINE)
        still = int(round(self.rest * FPS * FINE))
        moving = point_masses(start, self.loop, t[: len(t) - still])
        places = np.concatenate([np.repeat(start[None], still, axis=0), moving])
        return Motion(t, np.stack([places[..., 0], np.zeros(places.shape[:2]), places[..., 1]], axis=-1))


LENS = View(bending=(-0.12, 0.05), noise=5.0)
LOOP, CHAIN = replace(LENS, centre=(0.14, -0.1), distance=0.7), replace(LENS, centre=(0.0, -0.2), distance=1.1)
DEGREE = np.pi / 180
FILMS = {
    f.name: f
    for f in (
        Film("loop, slanting camera", True, replace(LOOP, slant=(7 * DEGREE, -4 * DEGREE)), links=5),
        Film("chain, slanting camera", False, replace(CHAIN, slant=(-5 * DEGREE, 6 * DEGREE))),
        Film("loop, blurred", True, replace(LOOP, exposure=1 / 160, blur=1.5), links=5),
        Film("chain, blurred", False, replace(CHAIN, exposure=1 / 160, blur=1.5)),
        Film("loop, post in the first second", True, replace(LOOP, post=(0.13, 0.03)), links=5, rest=0.7, duration=3.5),
        Film(
            "chain, cover moves over", False,
            replace(CHAIN, cover=Cover(0.8, 1.6, (-0.35, -0.2), (0.35, -0.2), (0.07, 0.6))),
        ),
        Film(
            "loop, cover moves over", True,
            replace(LOOP, cover=Cover(0.3, 1.2, (-0.1, -0.2), (0.4, -0.1), (0.06, 0.3))), links=5,
        ),
        Film("loop, first circles missing", True, replace(LOOP, hidden=((2, 0, 8), (4, 0, 14))), links=5),
    )
}  # fmt: skip


def make(what: Film, folder: Path, boards: int = BOARDS) -> tuple[Path, list[Path], np.ndarray]:
    """The film, pictures of boards by its camera, and the true angles (k, links) [rad], counter-clockwise."""
    motion = what.motion()
    path = write_video(folder / "film.avi", film(motion, what.view, FPS), FPS)
    pictures = [folder / f"board-{i}.png" for i in range(boards)]
    for board, image in zip(pictures, chessboards(what.view, count=boards), strict=True):
        opencv().imwrite(str(board), image)
    link = np.diff(motion.nodes[::FINE][..., [0, 2]], axis=1)
    return path, pictures, np.arctan2(link[..., 1], link[..., 0])


def judged(what: Film, path: Path, boards: list[Path], truth: np.ndarray) -> Found:
    """How well a film is tracked, with `boards` or without (an empty list)."""
    given = {"calibration": boards, "plane": boards[0], "square": 0.03} if boards else {}
    row = {"film": what.name, "calibrated": bool(boards)}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = track(path, what.nodes, **given)
    except AmbiguousOrderError as error:
        return {**row, "status": "ambiguous_order", "message": str(error)}
    frames = np.round(found.trace.t * FPS).astype(int)
    off = _turns(found.trace.theta - truth[frames])
    known = np.isfinite(off)
    rms, stated = (float(np.sqrt(np.mean(x[known] ** 2))) for x in (off, found.trace.se))
    links = [_ratio(found.trace.se[known[:, j], j], off[known[:, j], j]) for j in range(what.links)]
    return {
        **row,
        "status": found.status,
        "right_order": bool(np.abs(off[known]).max() < RIGHT),
        "frames": len(frames),
        "first_frame": int(frames[0]),
        "rms_mrad": 1e3 * rms,
        "largest_mrad": 1e3 * float(np.abs(off[known]).max()),
        "stated_over_true": stated / rms,
        "of_links": [min(links), max(links)],
        "empty_share": float(1 - known.mean()),
        "marked_share": float(found.marks.frames.mean()),
        "slant_deg": None if found.slant is None else [float(x / DEGREE) for x in found.slant],
    }


def _turns(angle: np.ndarray) -> np.ndarray:
    """Angles [rad] without full turns."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _ratio(stated: np.ndarray, off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(stated**2) / np.mean(off**2)))


def spoiled(what: Film, draws: int = 40, seed: int = 0) -> Found:
    """Shares of frames marked where names of two nodes were swapped, where one node jumped, and where all is well."""
    rng = np.random.default_rng(seed)
    pixels = what.motion().nodes[::FINE][..., [0, 2]] * what.view.pixels_per_metre * [1.0, -1.0]
    frames, nodes = pixels.shape[:2]
    counts = dict.fromkeys(("swapped", "swapped_found", "jumped", "jumped_found", "well", "well_marked"), 0)
    for _ in range(draws):
        places = pixels + NOISE * rng.standard_normal(pixels.shape)
        first, last = rng.integers(5, frames // 2 - 20), rng.integers(frames // 2 + 20, frames - 10)
        swap, jump = np.zeros(frames, bool), np.zeros(frames, bool)
        swap[first : first + rng.integers(1, 20)] = True
        jump[last : last + rng.integers(1, 4)] = True
        a, b = rng.choice(nodes, 2, replace=False)
        places[np.ix_(swap, [a, b])] = places[np.ix_(swap, [b, a])]
        way = rng.uniform(0, 2 * np.pi)
        places[jump, rng.integers(nodes)] += (
            rng.uniform(0.2, 1.0) * 0.1 * what.view.pixels_per_metre * np.array([np.cos(way), np.sin(way)])
        )
        marked = find_marks(places, np.ones((frames, nodes), bool)).frames
        for name, where in (("swapped", swap), ("jumped", jump), ("well", ~swap & ~jump)):
            counts[name] += int(where.sum())
            counts["well_marked" if name == "well" else f"{name}_found"] += int((marked & where).sum())
    return {"film": what.name, **counts}


@command(films=list(FILMS))
def main(args) -> None:
    chosen = [FILMS[name] for name in args.films]
    rows = []
    for what in chosen:
        with tempfile.TemporaryDirectory() as folder:
            path, boards, truth = make(what, Path(folder))
            for given in (boards, []):
                rows.append(judged(what, path, given, truth))
                say(rows[-1])
    marks = [spoiled(FILMS[name]) for name in ("loop, slanting camera", "chain, slanting camera")]
    say(marks)
    if len(chosen) == len(FILMS):
        store("films", {"films": rows, "marks": marks})
