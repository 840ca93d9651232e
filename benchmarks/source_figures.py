"""Figures of the paper and the thesis that show a simulation, drawn from runs of this simulator alone.

    python benchmarks/source_figures.py [NAME ...] [--plot FOLDER] [--traces FILE.csv]

NAME is source and number, such as paper-6 or thesis-8.27, or all; without one they are listed. `--traces` draws your
own measured angles on the thesis' figures that compare with the experiment.

`figure_table` lists the figures and their scenes. Figures of the paper compare two other
programs; here they have one curve, from the paper's start (the scenes `-table-6`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from figure_table import SAMPLE_INTERVAL, Case, Run, SourceFigure, cases_of, figure_of, figures, scene_of
from matplotlib.figure import Figure
from study import command

from dropper_jax import plots
from dropper_jax.analysis.angles import angle_rates, link_angles
from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import surface_over
from dropper_jax.modelling.build import build, build_model
from dropper_jax.plots import style, view
from dropper_jax.plots.figures import new_figure, save
from dropper_jax.plots.run import readable
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.space_axes import space_axes
from dropper_jax.plots.time_panels import Curve, Panel, history
from dropper_jax.quantities.end_links import point_loads
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.study import accuracy_pictures
from dropper_jax.study.convergence import convergence
from fitting.traces.trace_file import read_trace

AXES = ("x", "y", "z")

#: Times (k,) [s] and angles (k, n) [rad] from the horizontal, positive downwards.
Measured = tuple[np.ndarray, np.ndarray]


@style.plot_style()
def draw_figure(
    figure: SourceFigure, runs: Sequence[Run], path: str | Path, measured: Measured | None = None
) -> list[Path]:
    """Draw a figure; a configuration at the surface has two pictures, `FILE` from two sides and `FILE-3d` in space.

    Args:
        runs: of its cases; empty for a figure without runs.
        measured: measured angles to overlay, for a scene with the same number of links and the same duration.
    """
    path = Path(path)
    if measured is not None and runs and measured[1].shape[1] != runs[0].solution.tension.shape[1]:
        measured = None
    if figure.kind in FROM_SCENE:
        return [FROM_SCENE[figure.kind](figure, path)]
    if figure.kind in CONFIGURATIONS:
        return CONFIGURATIONS[figure.kind](figure, runs[0].solution, path)
    if figure.kind in HISTORIES:
        solution = runs[0].solution
        run = readable(dataclasses.replace(solution, scene=dataclasses.replace(solution.scene, name=figure.name)))
        panels = HISTORIES[figure.kind](figure, solution, measured)
        if figure.span is not None:
            panels = [panel._replace(curves=[_part(curve, *figure.span) for curve in panel.curves]) for panel in panels]
            run = dataclasses.replace(run, t=np.clip(run.t, *figure.span))
        return [history(run, path, figure.caption, panels)]
    panels, columns = PANELS[figure.kind](figure, runs, measured)
    return [_grid(figure, panels, columns, path)]


def _part(curve: Curve, begin: float, end: float) -> Curve:
    kept = (curve.t >= begin) & (curve.t <= end)
    return curve._replace(t=curve.t[kept], values=curve.values[kept])


def _series(figure: SourceFigure, solution: Solution, measured: Measured | None) -> list[Panel]:
    scene = solution.scene
    found = []
    for name in figure.panels:
        if name in AXES:
            position = solution.point_path(scene.buoys[0].point)[:, AXES.index(name)]
            # minimum motion [m] of a buoy along an axis with a panel
            if np.ptp(position) < 1e-6:
                continue
            found.append(Panel(f"{name} [m]", [Curve("", solution.t, position)], f"buoy, {name}"))
        elif name == "tension":
            anchor = next(point.name for point in scene.points if not point.is_free)
            load = np.linalg.norm(point_loads(solution.motion)[anchor][1:], axis=1)
            unit, size = force_unit(load)
            found.append(Panel(f"tension [{unit}]", [Curve("", solution.t_tension[1:], load / size)], "anchor"))
        else:
            eta = elevation_at_origin(scene, solution.t)
            found.append(Panel("elevation [m]", [Curve("", solution.t, eta)], zero=True))
    return found


def elevation_at_origin(scene: Scene, times: np.ndarray) -> np.ndarray:
    """Elevation (k,) [m] at the origin."""
    return surface_over(scene, np.zeros((len(times), 1, 3)), times)[:, 0]


def _angles(figure: SourceFigure, solution: Solution, measured: Measured | None) -> list[Panel]:
    """A panel per link: simulated, and measured if given."""
    panels = []
    for link in range(solution.tension.shape[1]):
        curves = [Curve("simulated" if measured else "", solution.t, solution.polar[:, link])]
        if measured is not None:
            t, theta = measured
            kept = t <= solution.t[-1]
            curves.append(Curve("measured", t[kept], theta[kept, link], colour=style.SECOND))
        panels.append(Panel(f"link {link + 1} [rad]", curves))
    return panels


class Lines(NamedTuple):
    """One panel of curves (name, x, y)."""

    title: str
    x: str
    y: str
    curves: list[tuple[str, np.ndarray, np.ndarray]]
    equal: bool = False
    start: bool = False


def _grid(figure: SourceFigure, panels: list[Lines], columns: int, path: Path) -> Path:
    """Panels row by row; the measured curve in black below the others."""
    rows = -(-len(panels) // columns)
    wide = figure.kind in ("curve", "history", "spectrum")
    if wide:
        size = (9.0, 3.4 if len(panels) == 1 else 2.4)
    elif len(panels) == 1:
        size = (6.4, 5.6)
    else:
        size = (3.1 * columns, 2.7)
    if rows > 8:
        size = (9.0, 1.5)
    picture = new_figure(size[0], 0.7 + size[1] * rows)
    grid = picture.subplots(rows, columns, squeeze=False, sharex=figure.kind == "history").ravel()
    for axes, panel in zip(grid, panels, strict=False):
        colours = iter(style.CYCLE)
        for name, x, y in panel.curves:
            if name == "measured":
                look = {"color": style.DARK, "lw": 2.0, "alpha": 0.45}
            else:
                look = {"color": next(colours)}
            axes.plot(x, y, label=name or None, **({"lw": 0.6 if len(x) > 4000 else 1.1} | look))
        if panel.start:
            axes.plot(*(v[0] for v in panel.curves[0][1:]), "o", ms=5, mfc="white", mec=style.DARK)
        axes.set_title(panel.title, loc="left", fontsize=9)
        axes.set_ylabel(panel.y)
        axes.margins(x=0.0 if wide else 0.05)
        axes.set_aspect("equal" if panel.equal else "auto")
    for axes, panel in zip(grid[: len(panels)][-columns:] if figure.kind == "history" else grid, panels, strict=False):
        axes.set_xlabel(panel.x)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    handles, names = grid[0].get_legend_handles_labels()
    if names:
        picture.legend(handles, names, loc="outside lower left", ncols=len(names))
    _entitle(picture, figure)
    return save(picture, path)


def _entitle(picture: Figure, figure: SourceFigure) -> None:
    picture.suptitle(f"{figure.name}\n{figure.caption}", fontsize=10, fontweight="bold", x=0.01, ha="left")


def _each(figure: SourceFigure, run: Run) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Name of a link, name of an angle, its values and rates (k,) [rad], [rad/s], link by link."""
    positions = run.solution.positions
    velocities = run.solution.velocities
    angles = link_angles(positions, figure.zero)
    rates = angle_rates(positions, velocities, figure.zero)
    for link in [number - 1 for number in figure.links] or range(run.solution.tension.shape[1]):
        for angle in figure.angles:
            row = ("polar", "azimuth").index(angle)
            yield f"link {link + 1}", angle, np.asarray(angles[row])[:, link], np.asarray(rates[row])[:, link]


def _phase(figure: SourceFigure, runs: Sequence[Run], _: Measured | None) -> tuple[list[Lines], int]:
    found = [
        Lines("; ".join(filter(None, (run.label, link))), f"{angle} [rad]", "rate [rad/s]", [("", x, y)], start=True)
        for run in runs
        for link, angle, x, y in _each(figure, run)
    ]
    return found, min(len(found), 4 if len(found) > 2 else 2)


def _history(figure: SourceFigure, runs: Sequence[Run], _: Measured | None) -> tuple[list[Lines], int]:
    (run,) = runs
    found = [
        Lines(link, "time [s]", f"{angle} [rad]", [("", run.solution.t, x)]) for link, angle, x, _ in _each(figure, run)
    ]
    return found, len(figure.angles) if len(figure.links) > 1 else 1


def _plan(_: SourceFigure, runs: Sequence[Run], __: Measured | None) -> tuple[list[Lines], int]:
    (run,) = runs
    paths = run.solution.positions[:, 1:]
    curves = [("", paths[:, node, 0], paths[:, node, 1]) for node in range(paths.shape[1])]
    return [Lines("", "x [m]", "y [m]", curves, equal=True, start=True)], 1


def _curve(figure: SourceFigure, runs: Sequence[Run], measured: Measured | None) -> tuple[list[Lines], int]:
    curves = _of_cases(figure, runs, measured)
    (link,) = figure.links
    return [Lines("", "time [s]", f"angle of link {link} [rad]", [(name, t, x[:, 0]) for name, t, x in curves])], 1


def _spectrum(figure: SourceFigure, runs: Sequence[Run], measured: Measured | None) -> tuple[list[Lines], int]:
    curves = [(name, *amplitude_spectrum(t, x)) for name, t, x in _of_cases(figure, runs, measured)]
    found = []
    for column, angle in enumerate(figure.angles):
        for low in figure.from_hz:
            # maximum frequency of a spectrum [Hz]; the motions of the sources are slower
            shown = [(name, f[part := (f >= low) & (f <= 6.0)], a[part, column]) for name, f, a in curves]
            title = f"{angle}, from {low:g} Hz" if len(figure.from_hz) > 1 else ""
            found.append(Lines(title, "frequency [Hz]", "amplitude [rad]", shown))
    return found, len(figure.from_hz)


def _of_cases(
    figure: SourceFigure, runs: Sequence[Run], measured: Measured | None
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Name, times (k,) [s] and angles (k, angles) [rad] of the link within the span: measured, then every case."""
    (link,) = figure.links
    begin, end = figure.span or (0.0, np.inf)
    found = []
    if measured is not None:
        t, theta = measured
        kept = np.isfinite(theta[:, link - 1]) & (t >= begin) & (t <= end)
        even = np.linspace(*t[kept][[0, -1]], int(kept.sum()))
        found.append(("measured", even, np.interp(even, t[kept], theta[kept, link - 1])[:, None]))
    for run in runs:
        kept = (run.solution.t >= begin - 1e-9) & (run.solution.t <= end + 1e-9)
        angles = np.stack([x[kept] for _, _, x, _ in _each(figure, run)], axis=1)
        found.append((run.label, run.solution.t[kept], angles))
    return found


#: Panels of curves, and the number of columns, by kind.
PANELS = {"phase": _phase, "history": _history, "plan": _plan, "curve": _curve, "spectrum": _spectrum}


def _pose(figure: SourceFigure, solution: Solution, path: Path) -> list[Path]:
    time = min(figure.at, float(solution.t[-1]))
    solution = dataclasses.replace(solution, scene=dataclasses.replace(solution.scene, name=figure.name))
    if not figure.surface:
        return [plots.snapshot(solution, path, time=time)]
    space = path.with_stem(f"{path.stem}-3d")
    return [plots.under_surface(solution, path, time=time), plots.snapshot(solution, space, time=time)]


def _space(figure: SourceFigure, solution: Solution, path: Path) -> list[Path]:
    """Paths of the nodes in space, their samples as points."""
    positions = solution.positions
    limits = view.box(positions)
    picture = new_figure(*view.figure_size(limits), layout=None)
    axes = space_axes(picture, limits)
    few = positions[:: max(1, len(positions) // 5000)]
    for node in range(1, positions.shape[1]):
        axes.plot(*few[:, node].T, ".", ms=1.6, color=style.CYCLE[node - 1], label=f"pendulum {node}")
    axes.plot(*positions[0].T, "o-", color=style.DARK, lw=1.2, ms=4)
    picture.legend(loc="lower left", ncols=3, markerscale=4)
    _entitle(picture, figure)
    return [save(picture, path)]


def _steps(figure: SourceFigure, path: Path) -> Path:
    """Differences of angles between steps and their halves."""
    links = [number - 1 for number in figure.links] or slice(None)
    kinds = ("polar", "azimuth")
    found = [
        row | {kind: None if row[kind] is None else row[kind][:, links] for kind in kinds}
        for row in _compared_steps(figure.scenes[0], figure.duration)
    ]
    return accuracy_pictures.convergence({"convergence": found, "scene": figure.name, "links": figure.links}, path)


@cache
def _compared_steps(scene: str, duration: float) -> list[dict[str, Any]]:
    """The differences of one study, used in two figures."""
    # interval of compared states [s]
    grid = 0.08
    return convergence(*build(scene_of(scene)), grid, round(duration / grid), [0.08, 0.04, 0.02, 0.01, 0.005, 0.0025])


def _elevation(figure: SourceFigure, path: Path) -> Path:
    scene = scene_of(figure.scenes[0])
    t = np.arange(0.0, scene.run.duration + 1e-9, SAMPLE_INTERVAL)
    panel = Lines("", "time [s]", "elevation [m]", [("", t, elevation_at_origin(scene, t))])
    return _grid(dataclasses.replace(figure, kind="curve"), [panel], 1, path)


def _profile(figure: SourceFigure, path: Path) -> Path:
    sea = build_model(scene_of(figure.scenes[0]), "float64").sea
    z = np.linspace(-float(sea.depth), 0.0, 121)
    positions = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=-1)
    # final speed of a current that rises from slack water
    flow = np.asarray(sea.stream(jnp.asarray(positions), jnp.asarray(1e6)))
    picture = new_figure(5.0, 5.2)
    axes = picture.subplots()
    axes.plot(np.linalg.norm(flow, axis=-1), z, color=style.FIRST)
    axes.set(xlabel="speed of the current [m/s]", ylabel="z [m]", xlim=(0.0, None))
    _entitle(picture, figure)
    return save(picture, path)


#: Drawings by kind: from the scene alone, of one configuration or motion, of quantities against time.
FROM_SCENE = {"steps": _steps, "profile": _profile, "elevation": _elevation}
CONFIGURATIONS = {"pose": _pose, "space": _space}
HISTORIES = {"angles": _angles, "series": _series}


def read_measured(file: str) -> Measured:
    """Times [s] and angles [rad] from the horizontal, positive downwards."""
    trace = read_trace(file)
    return trace.t, trace.in_model_convention(trace.convention).theta


@cache
def run_of(case: Case) -> Solution:
    """The run of a case, which several figures may show."""
    return simulate(scene_of(*case.key))


def draw(names: list[str], folder: Path, traces: str | None) -> bool:
    """Draw figures into a folder; whether the runs of all of them completed."""
    measured = read_measured(traces) if traces else None
    chosen = list(figures()) if "all" in names else list(dict.fromkeys(names))
    good = True
    for figure in map(figure_of, chosen):
        runs = [Run(case.label, run_of(case)) for case in cases_of(figure)]
        failures = [run.solution.failure for run in runs if run.solution.failure]
        if failures:
            print(f"error: {figure.name}: {failures[0]}", flush=True)
            good = False
            continue
        for file in draw_figure(figure, runs, folder / f"{figure.name}.png", measured):
            print(file, flush=True)
    return good


@command({"names": [str]}, plot="figures", traces=str)
def main(args) -> int:
    if not args.names:
        print("\n".join(f"{figure.name:16s}{figure.caption}" for figure in figures().values()))
        return 0
    folder = Path(args.plot)
    folder.mkdir(parents=True, exist_ok=True)
    if draw(args.names, folder, args.traces):
        return 0
    return 1
