"""Eight films of known motion, tracked: order of the nodes, errors of the angles, standard errors, marks.

The motion is that of point masses on rigid massless links in the plane, integrated by SciPy (`closed_chain`), so that
nothing of the simulator is in it. Each film is rendered with a bending lens and tracked twice: with boards (lens and
plane) and without anything.
"""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from closed_chain import in_space, rigid_line, still

from fitting import Motion, wrap
from fitting.films import track
from fitting.films.detection import Circles
from fitting.films.marks import find_marks
from fitting.films.ordering import AmbiguousOrderError
from fitting.films.render import POST, View, chessboards, film, in_sixteenths
from fitting.films.video import opencv, write_video

FPS = 60.0
#: Samples per frame of the motion that the renderer interpolates.
FINE = 8
#: Pictures of the board; noise of a centre where marks are tried [pixel]; largest error of an angle in the right order
#: [rad].
BOARDS, NOISE, RIGHT = 8, 0.05, 0.2


def closed(guess: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """The places (n, 2) nearest to a guess whose links have their lengths, the ends held (Gauss-Newton)."""
    places, j = np.array(guess, float), np.arange(len(lengths))
    for _ in range(50):
        link = np.diff(places, axis=0)
        slopes = np.zeros((len(lengths), *places.shape))  # of |d|^2/2 by the places
        slopes[j, j], slopes[j, j + 1] = -link, link
        short = 0.5 * (lengths**2 - np.sum(link**2, axis=1))
        moves = np.linalg.lstsq(slopes[:, 1:-1].reshape(len(lengths), -1), short, rcond=None)[0]
        places[1:-1] += moves.reshape(-1, 2)
    return places


def point_masses(start: np.ndarray, loop: bool, t: np.ndarray, damping: float = 0.15) -> np.ndarray:
    """Nodes (k, n, 3) [m] at the times t (k,) of unit masses released at `start` (n, 3), by SciPy (`closed_chain`).

    Node 0 is held, in a loop the last one too.

    Args:
        damping: c/m [1/s].
    """
    held = start[[0, -1]] if loop else start[:1]
    lengths = np.linalg.norm(np.diff(start, axis=0), axis=1)
    masses = np.ones(len(start) - len(held))
    ends = tuple(map(still, held))
    return rigid_line(t, start, np.zeros_like(start), lengths, masses, b_l=damping, ends=ends)


@dataclass(frozen=True)
class Cover:
    """An upright plate before the motion, of a size [m], whose middle (x, z) [m] moves between two times [s].

    Before and after it is out of view.
    """

    begin: float
    end: float
    start: tuple[float, float]
    stop: tuple[float, float]
    size: tuple[float, float]

    def draw(self, image: np.ndarray, view: View, t: float) -> np.ndarray:
        share = (t - self.begin) / (self.end - self.begin)
        if 0 <= share <= 1:
            middle = np.array([1.0 - share, share]) @ [self.start, self.stop]
            corners = middle + 0.5 * np.array(self.size) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]
            opencv().fillPoly(image, [in_sixteenths(view.to_pixels(corners))], POST, shift=4)
        return image


@dataclass(frozen=True)
class Film:
    """What is filmed: chain or loop, `links` of 0.1 m, released after `rest` [s], and how."""

    name: str
    loop: bool
    view: View
    links: int = 4
    rest: float = 0.0
    duration: float = 3.0
    cover: Cover | None = None

    @property
    def nodes(self) -> int:
        return self.links + 1

    def motion(self) -> Motion:
        """Fine samples of the run, in the plane y = 0."""
        lengths = np.full(self.links, 0.1)
        if self.loop:
            span = np.linspace(0, 1, self.nodes)
            # pulled up and to the side: the low nodes swing through half the span
            guess = np.stack([0.056 * self.links * span, 0.05 - 0.25 * span * np.sin(np.pi * span**3)], axis=1)
            guess[[0, -1], 1] = 0.0
            start = closed(guess, lengths)
        else:
            angle = np.deg2rad(-20 - 14.0 * np.arange(self.links))
            link = lengths[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            start = np.concatenate([np.zeros((1, 2)), np.cumsum(link, axis=0)])
        start = in_space(start)
        t = np.arange(round(self.duration * FPS) * FINE + 1) / (FPS * FINE)
        still_samples = round(self.rest * FPS * FINE)
        moving = point_masses(start, self.loop, t[: len(t) - still_samples])
        return Motion(t, np.concatenate([np.repeat(start[None], still_samples, axis=0), moving]))

    def positions(self) -> np.ndarray:
        """True nodes (k, n, 2) (x, z) [m] of the frames."""
        return self.motion().nodes[::FINE][..., [0, 2]]

    def pixels(self) -> np.ndarray:
        """The same in the picture [pixel]."""
        return np.stack([self.view.to_pixels(each) for each in self.positions()])


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
            "chain, cover moves over", False, CHAIN, cover=Cover(0.8, 1.6, (-0.35, -0.2), (0.35, -0.2), (0.07, 0.6)),
        ),
        Film(
            "loop, cover moves over", True, LOOP, links=5,
            cover=Cover(0.3, 1.2, (-0.1, -0.2), (0.4, -0.1), (0.06, 0.3)),
        ),
        Film("loop, first circles missing", True, replace(LOOP, hidden=((2, 0, 8), (4, 0, 14))), links=5),
    )
}  # fmt: skip


def discs(places, radius=7.0, size=(320, 240), noise=4.0):
    """Frames with bright discs at places (k, n, 2) [pixel], and noise."""
    y, x = np.mgrid[: size[1], : size[0]]
    rng = np.random.default_rng(0)
    for each in places:
        image = 60.0 + noise * rng.standard_normal(x.shape)
        for cx, cy in each:
            image += 150.0 * np.clip(0.5 + radius - np.hypot(x - cx, y - cy), 0.0, 1.0)
        yield np.clip(image, 0, 255).astype(np.uint8)


def circles(centres, error=0.05):
    """Circles of one frame at centres (m, 2) [pixel]."""
    n = len(centres)
    return Circles(np.asarray(centres, float), np.full(n, error), np.full(n, 6.0), np.ones(n), np.full(n, 100.0))


def stiff_zigzag(turn):
    """Nodes (k, 4, 2) [pixel] of a zigzag about 0 that turns as a whole by angles (k,): every distance stays."""
    shape = np.array([[-90.0, 20.0], [-30.0, -50.0], [30.0, 40.0], [100.0, -10.0]])
    return np.einsum("kij,nj->kni", np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]).T, shape)


def save_images(folder, images):
    paths = []
    for i, image in enumerate(images):
        paths.append(str(folder / f"board-{i}.png"))
        opencv().imwrite(paths[-1], image)
    return paths


def make(what: Film, folder: Path) -> tuple[Path, list[str], np.ndarray]:
    """The film, pictures of boards by its camera, and the true angles (k, links) [rad], counter-clockwise."""
    motion = what.motion()
    frames = film(motion, what.view, FPS)
    if what.cover is not None:
        frames = (what.cover.draw(image, what.view, i / FPS) for i, image in enumerate(frames))
    path = write_video(folder / "film.avi", frames, FPS)
    pictures = save_images(folder, chessboards(what.view, count=BOARDS))
    link = np.diff(motion.nodes[::FINE][..., [0, 2]], axis=1)
    return path, pictures, np.arctan2(link[..., 1], link[..., 0])


def judged(what: Film, path: Path, boards: list[str], truth: np.ndarray) -> dict[str, Any]:
    """How well a film is tracked, with `boards` or without (an empty list)."""
    given = {"calibration": boards, "plane": boards[0], "square": 0.03} if boards else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = track(path, what.nodes, **given)
    except AmbiguousOrderError as error:
        return {"status": "ambiguous_order", "message": str(error)}
    frames = np.round(found.trace.t * FPS).astype(int)
    off = wrap(found.trace.theta - truth[frames])
    known = np.isfinite(off)
    rms, stated = (float(np.sqrt(np.mean(x[known] ** 2))) for x in (off, found.trace.se))
    return {
        "status": found.status,
        "right_order": bool(np.abs(off[known]).max() < RIGHT),
        "first_frame": int(frames[0]),
        "rms_mrad": 1e3 * rms,
        "stated_over_true": stated / rms,
        "marked_share": float(found.marks.frames.mean()),
    }


def spoiled(what: Film, draws: int = 40, seed: int = 0) -> dict[str, Any]:
    """Shares of frames marked where names of two nodes were swapped, where one node jumped, and where all is well."""
    rng = np.random.default_rng(seed)
    pixels = what.positions() * what.view.pixels_per_metre * [1.0, -1.0]
    frames, nodes = pixels.shape[:2]
    counts = dict.fromkeys(("swapped", "swapped_found", "jumped", "jumped_found", "well", "well_marked"), 0)
    for _ in range(draws):
        places = pixels + NOISE * rng.standard_normal(pixels.shape)
        first, last = rng.integers(5, frames // 2 - 20), rng.integers(frames // 2 + 20, frames - 10)
        late = np.arange(frames)
        swap = (late >= first) & (late < first + rng.integers(1, 20))
        jump = (late >= last) & (late < last + rng.integers(1, 4))
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
    return counts
