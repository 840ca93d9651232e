"""Figures of the paper (6 to 19) and of the thesis (8.20, 8.27, 8.30, 8.32), from runs of this simulator alone.

The paper's compare two other programs; here stands one curve, from the paper's start (the scenes `-table-6`).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from dropper_jax import plots
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.named import find_scene
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import plain_values
from dropper_jax.load.surroundings import surface_over
from dropper_jax.plots import style
from dropper_jax.plots.run import readable
from dropper_jax.plots.series import Curve, Panel, history
from dropper_jax.plots.units import force_unit
from dropper_jax.run.build import build_model
from dropper_jax.run.loads import point_load
from dropper_jax.run.solution import Solution

#: What stands in a figure: `series` names its panels in order.
SERIES = ("x", "y", "z", "tension", "elevation", "polar", "azimuth")
#: The link whose angles the thesis discusses in waves; the caption of its Figure 8.32 has the first (erratum).
LINK = 10
#: A buoy that moves by less than this [m] along an axis has no panel for it.
STILL = 1e-6
#: Time of the paper's state of the mooring [s], and how long its runs are taken here.
STATE, PAPER_SPAN, THESIS_SPAN = 143.9, 150.0, 50.0


@dataclasses.dataclass(frozen=True)
class SourceFigure:
    """A figure of one of the sources.

    Attributes:
        name: as it is asked for, such as `paper-6`.
        caption: what it shows.
        scene: packaged scene, with `values` set.
        kind: `series`, `state`, `profile` or `angles`.
        series: its panels, of `SERIES`.
        span: part of the time that is drawn [s]; None: all of it.
        duration: simulated time [s]; 0 where nothing is simulated.
    """

    name: str
    caption: str
    scene: str
    kind: str = "series"
    series: tuple[str, ...] = ()
    span: tuple[float, float] | None = None
    duration: float = PAPER_SPAN
    values: tuple[tuple[str, float], ...] = ()


def _paper(number: int, case: int, caption: str, *series: str, **more: object) -> SourceFigure:
    return SourceFigure(
        f"paper-{number}", f"case {case}: {caption}", f"paper-case-{case}-table-6", series=series, **more
    )


def _thesis(number: str, b_l: float) -> SourceFigure:
    values = (("effects.linear_damping.b_l", b_l), ("effects.quadratic_damping.b_q", 0.001))
    caption = f"angle of each link, scenario A, b_l = {b_l:g} kg/s, b_q = 0.001 kg/m"
    return SourceFigure(f"thesis-{number}", caption, "dropper-release-a", "angles", (), None, THESIS_SPAN, values)


def _north_sea(number: str, caption: str, *series: str) -> SourceFigure:
    """Of the thesis' dropper in waves, by (6.13): without relative velocity its motion depends on the step."""
    scene = "dropper-north-sea-thesis-relative"
    return SourceFigure(f"thesis-{number}", caption, scene, series=series, duration=30.0)


PLACE, SPAN = ("x", "y", "z"), (100.0, 114.0)
FIGURES = {
    figure.name: figure
    for figure in (
        _paper(6, 1, "position of the buoy and tension at the anchor", *PLACE, "tension"),
        _paper(7, 1, "tension at the anchor, 100 to 114 s", "tension", span=SPAN),
        _paper(8, 2, "position of the buoy", *PLACE),
        _paper(9, 2, "tension at the anchor", "tension"),
        _paper(10, 2, "tension at the anchor, 100 to 114 s", "tension", span=SPAN),
        _paper(11, 3, "elevation of the surface at the origin", "elevation"),
        _paper(12, 3, "position of the buoy", *PLACE),
        _paper(13, 3, "tension at the anchor", "tension"),
        _paper(14, 4, "speed of the current over depth", kind="profile", duration=0.0),
        _paper(15, 4, "position of the buoy", *PLACE),
        _paper(16, 4, "tension at the anchor", "tension"),
        _paper(17, 5, f"state of the mooring at {STATE:g} s", kind="state"),
        _paper(18, 5, "position of the buoy", *PLACE),
        _paper(19, 5, "tension at the anchor", "tension"),
        _thesis("8.20", 0.01),
        _thesis("8.27", 0.002),
        _north_sea("8.30", "elevation of the surface at the origin", "elevation"),
        _north_sea("8.32", f"elevation, and angles of link {LINK}", "elevation", "polar", "azimuth"),
    )
}


def figure_of(name: str) -> SourceFigure:
    """The figure of a name.

    Raises:
        SceneError: there is none.
    """
    if name not in FIGURES:
        raise SceneError(f"figure: {name!r} is not one of them; {nearest(name, list(FIGURES))}")
    return FIGURES[name]


def scene_of(figure: SourceFigure) -> Scene:
    """The scene that a figure is drawn from."""
    found, name = find_scene(figure.scene)
    scene = Scene.from_dict(plain_values(found, None), name)
    values = dict(figure.values) | ({"run.duration": figure.duration} if figure.duration else {})
    return scene.with_values(values) if values else scene


@style.look()
def draw_figure(
    figure: SourceFigure,
    solution: Solution | None,
    path: str | Path,
    measured: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Path]:
    """The figure as a picture; a state of the mooring as two, `FILE` from two sides and `FILE-3d` in space.

    Args:
        solution: the run of its scene; None for what needs none.
        measured: of the thesis' figures, times (k,) [s] and angles (k, n) [rad] to lay over it.
    """
    path = Path(path)
    if figure.kind == "profile":
        return [_profile(figure, path)]
    if figure.kind == "state":
        time = min(STATE, float(solution.t[-1]))
        space = path.with_stem(f"{path.stem}-3d")
        return [plots.under_surface(solution, path, time=time), plots.snapshot(solution, space, time=time)]
    run = readable(solution)
    panels = _angles(solution, measured) if figure.kind == "angles" else _series(solution, figure)
    if figure.span is not None:
        panels = [panel._replace(curves=[_part(curve, *figure.span) for curve in panel.curves]) for panel in panels]
        run = dataclasses.replace(run, t=np.clip(run.t, *figure.span))
    return [history(run, path, f"{figure.name}, {figure.caption}", panels)]


def _part(curve: Curve, begin: float, end: float) -> Curve:
    kept = (curve.t >= begin) & (curve.t <= end)
    return curve._replace(t=curve.t[kept], values=curve.values[kept])


def _series(solution: Solution, figure: SourceFigure) -> list[Panel]:
    scene, found = solution.scene, []
    for name in figure.series:
        if name in PLACE:
            place = solution.point_path(scene.buoys[0].point)[:, PLACE.index(name)]
            if np.ptp(place) < STILL:
                continue
            found.append(Panel(f"{name} [m]", [Curve("", solution.t, place)], f"buoy, {name}"))
        elif name == "tension":
            anchor = next(point.name for point in scene.points if point.kind == "fixed")
            arrays = (solution.t, solution.positions, solution.t_tension[1:], solution.tension[1:])
            load = np.linalg.norm(point_load(scene, anchor, *arrays), axis=1)
            unit, size = force_unit(load)
            found.append(Panel(f"tension [{unit}]", [Curve("", solution.t_tension[1:], load / size)], "anchor"))
        elif name in ("polar", "azimuth"):
            found.append(Panel(f"{name} [rad]", [Curve("", solution.t, getattr(solution, name)[:, LINK - 1])]))
        else:
            eta = elevation_at_origin(scene, solution.t)
            found.append(Panel("elevation [m]", [Curve("", solution.t, eta)], zero=True))
    return found


def elevation_at_origin(scene: Scene, times: np.ndarray) -> np.ndarray:
    """Elevation (k,) [m] at the origin."""
    return surface_over(scene, np.zeros((len(times), 1, 3)), times)[:, 0]


def _angles(solution: Solution, measured: tuple[np.ndarray, np.ndarray] | None) -> list[Panel]:
    """A panel per link: simulated, and measured where that is given."""
    panels = []
    for link in range(solution.tension.shape[1]):
        curves = [Curve("simulated" if measured else "", solution.t, solution.polar[:, link])]
        if measured is not None:
            t, theta = measured
            kept = t <= solution.t[-1]
            curves.append(Curve("measured", t[kept], theta[kept, link], colour=style.SECOND))
        panels.append(Panel(f"link {link + 1} [rad]", curves))
    return panels


def _profile(figure: SourceFigure, path: Path) -> Path:
    scene = scene_of(figure)
    sea = build_model(scene, "float64").sea
    z = np.linspace(-float(sea.depth), 0.0, 121)
    places = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=-1)
    # of a current that rises from slack water, what it rises to
    flow = np.asarray(sea.stream(jnp.asarray(places), jnp.asarray(1e6)))
    picture = style.new_figure(5.0, 5.2)
    axes = picture.subplots()
    axes.plot(np.linalg.norm(flow, axis=-1), z, color=style.FIRST)
    axes.set(xlabel="speed of the current [m/s]", ylabel="z [m]", xlim=(0.0, None))
    picture.suptitle(f"{figure.name}, {figure.caption}", fontsize=11, fontweight="bold", x=0.01, ha="left")
    return style.save(picture, path)
