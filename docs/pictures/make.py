"""Make the pictures of the documentation: python docs/pictures/make.py [storm damping_sweep ...]"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import matplotlib.style
import numpy as np
from PIL import Image

import dropper_jax as dj
from dropper_jax import plots, statics
from dropper_jax.cli import main
from dropper_jax.plots import figures, style, tension_colours
from dropper_jax.report.page import view_page
from fitting.films import track
from fitting.films.overlay import write_overlay
from fitting.films.render import View, chessboards, film
from fitting.films.video import opencv, write_video
from fitting.sweep import open_sweep, sweep
from fitting.traces.synthetic import Motion
from fitting.traces.trace_file import write_trace

HERE = Path(__file__).parent
FIGURES = HERE.parents[1] / "benchmarks" / "source_figures.py"
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
#: As filmed in the tests: a bending lens, noise, a post, node 3 covered for ten frames.
VIEW = View(
    bending=(-0.12, 0.05), centre=(0.14, -0.14), distance=1.1, hidden=((3, 60, 69),), post=(0.30, 0.010), noise=5.0
)


def contact_sheet(work: Path) -> None:
    """Release of the lab dropper, filmed and tracked."""
    solution = dj.simulate("dropper-release-a", duration=2.2, dt=1 / 480, integrator="rattle")
    write_video(work / "lab.avi", film(Motion(solution.t, solution.positions), VIEW, 60.0), 60.0)
    boards = []
    for i, image in enumerate(chessboards(VIEW, count=8)):
        boards.append(work / f"board-{i}.png")
        opencv().imwrite(str(boards[-1]), image)
    tracked = track(work / "lab.avi", 8, calibration=boards, plane=boards[0], square=0.03)
    with Image.open(write_overlay(tracked, work / "lab.avi", work / "sheet.png")) as sheet:
        small = sheet.resize((sheet.width * 2 // 3, sheet.height * 2 // 3), Image.Resampling.LANCZOS)
        small.convert("RGB").save(HERE / "contact-sheet.jpg", quality=82)


def damping_sweep(work: Path) -> None:
    """Maximum tension and remaining energy of the lab dropper over both damping coefficients."""
    scene = dj.load_scene("dropper-release-a").with_values({"run.duration": 5.0, "run.integrator": "rattle"})
    values = {"b_l": np.geomspace(0.0005, 0.02, 24), "b_q": np.linspace(0.0, 0.01, 16)}
    sweep(scene, values, work / "damping.zarr", quantities=["tension_max", "energy_final"])
    with open_sweep(work / "damping.zarr") as found, matplotlib.style.context(["default", style.RC]):
        figure = figures.new_figure(9.5, 3.8)
        for axes, name, label in zip(
            figure.subplots(1, 2),
            ("tension_max", "energy_final"),
            ("maximum tension [N]", "energy at 5 s above rest [J]"),
            strict=True,
        ):
            level = np.asarray(found[name])
            if name == "energy_final":
                level = level - resting_energy(scene)
            mesh = axes.pcolormesh(
                values["b_l"], values["b_q"], level.T, cmap=tension_colours.tension_map(), shading="gouraud"
            )
            lines = axes.contour(values["b_l"], values["b_q"], level.T, 6, colors="white", linewidths=0.8)
            axes.set(xscale="log", title=label)
            axes.set(xlabel="linear damping b_l [kg/s]", ylabel="quadratic damping b_q [kg/m]")
            axes.grid(False)
            bar = figure.colorbar(mesh, ax=axes)
            bar.add_lines(lines)
            bar.set_ticks(lines.levels[1:-1])
        figures.save(figure, HERE / "damping-sweep.png")


def storm(work: Path) -> None:
    """The Edulis longline in the paper's waves, tension over time, and as the page shows it (this needs Chromium)."""
    solution = dj.simulate("edulis-longline", duration=60.0)
    with Image.open(plots.tension_history(solution, work / "tension.png")) as image:
        flat = image.convert("RGB").quantize(255, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        flat.save(HERE / "storm-tension.png", optimize=True)
    if not BROWSER:
        return
    page = view_page(solution)
    peak = float(solution.t[np.argmax(solution.tension.max(axis=1))])
    look = f"""<script>state.now = {peak};
      Object.assign(eye, {{ zoom: 2.8, rise: 0.15, turn: -0.5, shift: [20, 70] }});
      byId("names").checked = false; for (const id of ["about", "how"]) byId(id).hidden = true;
      document.querySelector("footer").hidden = true; document.querySelector("footer").style.display = "none";
      byId("name").textContent = "edulis-longline, t = {peak:.1f} s"; draw();</script></body>"""
    (work / "storm.html").write_text(page.replace("</body>", look), encoding="utf-8")
    options = [
        "--headless",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--hide-scrollbars",
    ]
    options += ["--window-size=1000,480", "--virtual-time-budget=4000", f"--user-data-dir={work}/profile"]
    shot = work / "storm.png"
    subprocess.run([BROWSER, *options, f"--screenshot={shot}", (work / "storm.html").as_uri()], check=True)
    with Image.open(shot) as image:
        image.convert("RGB").save(HERE / "storm.jpg", quality=85)


def sweep_against_fit(work: Path) -> None:
    """The thesis' fifteen pairs and the fit against a trace whose truth is none of them."""
    sys.path.insert(0, str(HERE.parents[1] / "benchmarks"))
    from sweep_truths import PAIRS, SCENE, truth

    trace = write_trace(work / "released.csv", truth(SCENE, 0.002, 0.001, 50.0, 0))
    vary = [f"--vary={name}={','.join(map(str, values))}" for name, values in PAIRS.items()]
    call = ["sweep", SCENE, "--paired", "--trace", str(trace), "--fit", "--out", str(work / "pairs.zarr"), *vary]
    main([*call, "--plot", str(work)])
    with Image.open(work / "scores.png") as image:
        small = image.convert("RGB").resize((1170, 900), Image.Resampling.LANCZOS)
        small.quantize(64).save(HERE / "sweep-against-fit.png", optimize=True)


#: Sheets of the sources' figures, what their names begin with, and figures next to each other.
SHEETS = {
    "figures-paper": ("paper-", 4),
    "figures-thesis-2-5": ("thesis-2 thesis-3 thesis-5", 4),
    "figures-thesis-8": ("thesis-8", 4),
    "figures-thesis-appendix": ("thesis-C thesis-E thesis-F thesis-G", 4),
}
CELL, GAP = (330, 260), 8


def source_figures(work: Path) -> None:
    """All figures of the sources, and their sheets."""
    subprocess.run([sys.executable, str(FIGURES), "all", "--plot", str(work)], check=True)
    sheets(work)


def sheets(work: Path) -> None:
    """Sheets of the figures in a folder, in their order."""
    rows = tomllib.loads(FIGURES.with_suffix(".toml").read_text(encoding="utf-8"))["figure"]
    names = [row["name"] for row in rows]
    for name, (begins, columns) in SHEETS.items():
        chosen = [figure for figure in names if figure.startswith(tuple(begins.split()))]
        rows = [
            [_small(work / f"{figure}.png") for figure in chosen[i : i + columns]]
            for i in range(0, len(chosen), columns)
        ]
        heights = [max(image.height for image in row) + GAP for row in rows]
        sheet = Image.new("RGB", ((CELL[0] + GAP) * columns, sum(heights)), "white")
        for i, row in enumerate(rows):
            for j, image in enumerate(row):
                sheet.paste(image, ((CELL[0] + GAP) * j, sum(heights[:i])))
        sheet.save(HERE / f"{name}.jpg", quality=80)


def _small(file: Path) -> Image.Image:
    with Image.open(file) as image:
        small = image.convert("RGB")
        small.thumbnail(CELL, Image.Resampling.LANCZOS)
        return small


def resting_energy(scene: dj.Scene) -> float:
    """Potential energy [J] of the line at rest; node n carries the mass of link n."""
    model = dj.build(scene)[0]
    z = np.asarray(statics.equilibrium(model).positions)[1:-1, 2]
    return float(9.81 * np.asarray(model.line.mass)[: len(z)] @ z)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for make in (contact_sheet, damping_sweep, storm, source_figures, sweep_against_fit):
            if not sys.argv[1:] or make.__name__ in sys.argv[1:]:
                make(Path(folder))
