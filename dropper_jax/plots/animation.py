"""Animation of a motion as a small GIF, or as an MP4 if ffmpeg is installed."""

from __future__ import annotations

import itertools
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D, proj3d
from PIL import Image

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write, remove_leftovers, unfinished_folder
from dropper_jax.base.progress import Progress, silent
from dropper_jax.plots import figures, marks, style, surroundings, tension_colours, view
from dropper_jax.plots.run import Run
from dropper_jax.plots.space_axes import bar_axes, space_axes
from dropper_jax.plots.style import ALERT, CYCLE, DARK, FAINT

#: Longest side of the drawn box [inch].
LONGEST_SIDE = 4.2

SUFFIXES = (".gif", ".mp4")
#: Colours of a frame besides those of the tension.
SOLID = (CYCLE[5], CYCLE[0], ALERT, surroundings.BUOY, surroundings.BED)


@style.with_style
def animate(
    run: Run,
    path: str | Path,
    fps: int = 25,
    seconds: float | None = None,
    progress: Progress | None = None,
) -> Path:
    """The motion as a GIF or MP4, links coloured by tension, with a trace of the middle node; a GIF repeats endlessly.

    The animation is in real time if that needs at most 240 frames, else faster; the title shows the speed.

    Args:
        fps: frames per second of playback; a GIF counts hundredths of a second, so 100/fps is rounded.
        seconds: how much of the motion [s] to show, from its start; None: all.
        progress: called with the fraction done, 0 to 1, and "animation".

    Returns:
        path of the file.

    Raises:
        ValueError: `fps` or `seconds` not positive.
        SceneError: another suffix, or an MP4 without ffmpeg.
    """
    path = Path(path)
    check_animation(path)
    if not fps > 0:
        raise ValueError(f"fps = {fps}: must be > 0")
    if seconds is not None and not seconds > 0:
        raise ValueError(f"seconds = {seconds}: must be > 0")
    progress = progress or silent
    delay = max(2, round(100 / fps)) * 10
    frames, speed = _timing(run.t, delay / 1000, seconds)
    stage = _Stage(run, frames, speed)

    def images() -> Iterator[np.ndarray]:
        for count, frame in enumerate(frames, start=1):
            yield stage.draw(frame)
            progress(count / len(frames), "animation")

    if path.suffix.lower() == ".mp4":
        return _write_mp4(path, images(), 1000 / delay)
    return _write_gif(path, images(), delay)


def check_animation(path: Path) -> None:
    """Reject a suffix that cannot be written.

    Raises:
        SceneError: with the allowed suffixes.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise SceneError(f"animation: {path.name!r} has no known suffix; allowed: {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise SceneError(f"animation: {path.name!r} needs ffmpeg, which is not installed; allowed: .gif")


def _write_gif(path: Path, images: Iterator[np.ndarray], delay: int) -> Path:
    """Frames (height, width, 3) of bytes, each shown for `delay` [ms], as a GIF with one palette, atomically."""
    palette = _palette()

    def quantised() -> Iterator[Image.Image]:
        for image in images:
            yield Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE)

    def write(file: BinaryIO) -> None:
        rest = quantised()
        first = next(rest)
        first.save(file, format="GIF", save_all=True, append_images=rest, duration=delay, loop=0, optimize=False)

    return atomic_write(path, write)


def _write_mp4(path: Path, images: Iterator[np.ndarray], fps: float) -> Path:
    """Frames (height, width, 3) of bytes as H.264 by ffmpeg, atomically."""
    first = next(images)
    height, width = first.shape[:2]
    remove_leftovers(path)
    # players require even sizes and 4:2:0
    target = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    # ffmpeg derives the format from the suffix; the rest of the name must not be predictable
    with unfinished_folder(path) as folder:
        part = folder / "film.mp4"
        call = ["ffmpeg", "-y", "-loglevel", "error", *source, *target, str(part)]
        with subprocess.Popen(call, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            with suppress(BrokenPipeError), process.stdin:  # an encoder that ended early reports its own error
                for image in itertools.chain([first], images):
                    process.stdin.write(image.tobytes())
            said = process.stderr.read().decode(errors="replace").split("\n")[0]
        if process.returncode:
            raise OSError(f"{path.name}: ffmpeg failed: {said or process.returncode}")
        part.replace(path)
    return path


def _timing(t: np.ndarray, delay: float, seconds: float | None) -> tuple[np.ndarray, float]:
    """Samples to draw and the playback speed (1 = real time) for frames `delay` [s] apart."""
    span = t[-1] - t[0]
    if seconds is not None:
        span = min(span, seconds)
    # maximum number of frames: 240 frames of about 700 x 470 pixels take 1.5 s and 1 to 3 MB
    count = max(1, min(240 - 1, round(span / delay), len(t)))
    times = t[0] + np.linspace(0.0, span, count + 1)
    frames = np.searchsorted(t, times - 1e-9 * max(span, 1.0)).clip(0, len(t) - 1)
    speed = 1.0
    if span > 0.0:
        speed = span / (count * delay)
    return np.unique(frames), speed


class _Stage:
    """A drawn background and the moving parts, which alone are redrawn for each frame.

    Attributes:
        trail: number of past frames in the path of a node.
        traced: this node.
        step: maximum number of samples between two frames.
        screen: positions of the nodes (k, nodes, 2) in the plane of the axes.
        surfaces, solids: lines of the surface, and outlines of buoys and bodies, there by frame.
    """

    trail = 10

    def __init__(self, run: Run, frames: np.ndarray, speed: float) -> None:
        self.t = run.t
        self.run = run
        shown = slice(frames[-1] + 1)
        positions = run.positions[shown]
        self.tension = run.tension[_nearest(run.t_tension, run.t[shown])]
        self.step = int(np.ceil(np.diff(frames).max(initial=1)))
        flat = view.planar(positions)
        limits = surroundings.limits(run, positions)
        self.figure = figures.new_figure(*view.figure_size(limits, LONGEST_SIDE), layout=None)
        self.axes = _axes(self.figure, limits, flat)
        # the first buoy is more informative than the middle of the list of nodes
        self.traced = run.buoys[0].node if run.buoys else positions.shape[1] // 2
        pace = "real time"
        if f"{speed:.2g}" != "1":
            pace = f"{speed:.2g} x real time"
        self._texts(pace)
        self._movers(flat)
        surroundings.draw_bed(self.axes, run, limits)
        self.canvas = FigureCanvasAgg(self.figure)
        figures.keep_dollars(self.figure)
        self.canvas.draw()
        self.screen = self._project(positions)
        self._surroundings(positions, surroundings.surface_lines(run, limits, flat, self.t[frames]), frames)
        self.background = self.canvas.copy_from_bbox(self.figure.bbox)

    def _texts(self, speed: str) -> None:
        run = self.run
        text, colour = figures.how(run)
        names = {node: name for name, node in run.point_names.items()}
        what = names.get(self.traced, f"node {self.traced}")
        note = f"thin line: path of {what}, last {self.trail} frames"
        self.clock = self.figure.text(0.98, 0.905, "", ha="right", fontsize=9, animated=True)
        self.figure.text(0.02, 0.955, f"{run.scene.name}: {speed}", fontsize=10, fontweight="bold")
        self.figure.text(0.98, 0.012, text, color=colour, fontsize=7, ha="right")
        self.figure.text(0.02, 0.012, note, color=FAINT, fontsize=7)

    def _movers(self, flat: bool) -> None:
        """The moving parts, in the order in which they are drawn."""
        run = self.run
        tension: dict[str, Any] = {
            "cmap": tension_colours.tension_map(),
            "norm": tension_colours.tension_norm(run.tension),
        }
        width = 1.2 if flat else 0.4
        self.surface = LineCollection([], colors=surroundings.SURFACE, linewidths=width)
        self.trace = Line2D([], [], color=FAINT, lw=1.0)
        self.links = LineCollection([], linewidths=3.5 * marks.bold(run), capstyle="round", **tension)
        self.buoys = PolyCollection([], facecolors=surroundings.BUOY, edgecolors=DARK, linewidths=0.7)
        self.nodes = Line2D([], [], ls="", marker="o", ms=marks.dot(run), mfc="white", mec=DARK, mew=0.9)
        self.fixed_points = Line2D([], [], ls="", marker="s", ms=7, mfc=DARK, mec="white")
        tension_colours.tension_bar(self.figure, self.links, run.tension, cax=bar_axes(self.figure))
        self.movers = (self.surface, self.trace, self.links, self.buoys, self.nodes, self.fixed_points)
        for artist in self.movers:
            artist.set(transform=self.axes.transData, figure=self.figure)

    def _surroundings(self, positions: np.ndarray, surface: np.ndarray | None, frames: np.ndarray) -> None:
        """Lines of the surface, and buoys and bodies of a system, at the frames, in screen coordinates."""
        run = self.run
        right = surroundings.right_of(self.axes)
        self.surfaces = {}
        self.solids = {}
        if surface is not None:
            self.surfaces = dict(zip(frames, self._project(surface), strict=True))
        for frame in frames:
            self.solids[frame] = list(self._project(surroundings.outlines(run, positions[frame], right)))
            if run.bodies is not None:
                self.solids[frame] += run.bodies.outlines(frame, self._project)

    def _project(self, positions: np.ndarray) -> np.ndarray:
        """Project positions (..., 3) to the plane of the axes, (..., 2)."""
        if not isinstance(self.axes, Axes3D):
            return positions[..., [0, 2]]
        x, y, _ = proj3d.proj_transform(*positions.reshape(-1, 3).T, self.axes.get_proj())
        return np.stack([x, y], axis=-1).reshape(*positions.shape[:-1], 2)

    def draw(self, frame: int) -> np.ndarray:
        """One frame (height, width, 3) of bytes."""
        nodes = self.screen[frame]
        self.canvas.restore_region(self.background)
        self.surface.set_segments(self.surfaces.get(frame, []))
        self.trace.set_data(*self.screen[max(0, frame - self.trail * self.step) : frame + 1, self.traced].T)
        self.links.set_segments(list(self.run.segments(nodes)))
        self.links.set_array(self.tension[frame])
        self.buoys.set_verts(self.solids[frame])
        self.nodes.set_data(*nodes.T)
        self.fixed_points.set_data(*nodes[list(self.run.fixed_nodes)].T)
        self.clock.set_text(f"t = {self.t[frame]:.2f} s")
        renderer = self.canvas.get_renderer()
        for artist in (*self.movers, self.clock):
            artist.draw(renderer)
        return np.asarray(self.canvas.buffer_rgba())[..., :3].copy()


def _palette() -> Image.Image:
    """The same colours for all frames: those of the style, and their mixtures with white for smooth edges."""
    tension = tension_colours.tension_map()(np.linspace(0.0, 1.0, 40))[:, :3]
    strong = np.concatenate([tension, [to_rgb(colour) for colour in SOLID]])
    mixed = 1 - np.multiply.outer((1.0, 0.75, 0.5, 0.25), 1 - strong)
    greys = np.linspace(to_rgb(DARK), (1.0, 1.0, 1.0), 32)
    colours = np.rint(255 * np.concatenate([*mixed, greys])).astype(int)
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.ravel().tolist())
    return palette


def _axes(figure: Figure, limits: np.ndarray, flat: bool) -> Axes:
    """Axes with space for the title and, on the right, for the colour bar."""
    if not flat:
        return space_axes(figure, limits, LONGEST_SIDE)
    inch = 1 / figure.get_figwidth()
    axes = view.flat_axes(figure, limits)
    axes.set_position((0.7 * inch, 0.13, 1 - 1.85 * inch, 0.76))
    return axes


def _nearest(times: np.ndarray, requested: np.ndarray) -> np.ndarray:
    """Index of the sample of sorted times `times` nearest to each of `requested`, the earlier one half way between."""
    share = np.interp(requested, times, np.arange(len(times)))
    return np.ceil(share - 0.5 - 1e-9).astype(int)
