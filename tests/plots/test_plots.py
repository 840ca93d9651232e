"""Pictures of made-up motions: valid files, whole or absent, also of runs that failed or are short."""

import dataclasses
import shutil
import sys
from functools import cache

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from dropper_jax import Scene, SceneError, plots
from dropper_jax.plots import figures, scales, style, tension_colours, view
from dropper_jax.plots.run import readable
from dropper_jax.plots.space_axes import bar_axes, space_axes
from dropper_jax.run.samples import Samples

STILLS = ("snapshot", "angle_traces", "phase_space", "amplitude_spectrum", "energy_balance")


@cache
def chain_of(links):
    """The scene of a hanging chain."""
    return Scene.from_dict(
        {
            "name": "made-up",
            "run": {"dt": 0.01, "duration": 1.0},
            "point": [
                {"name": "top", "kind": "fixed", "position": [0.0, 0.0, 0.0]},
                {"name": "bottom", "kind": "free", "position": [0.0, 0.0, -0.2 * links]},
            ],
            "line": [{"name": "chain", "from": "top", "to": "bottom", "links": links, "length": 0.2, "mass": 0.1}],
        }
    )


def run_of(samples, links=3, space=False, status="ok", dt=0.05):
    """A chain whose links swing at different rates; out of the x-z plane if `space`."""
    t = dt * np.arange(samples)
    order = np.arange(links)
    opening = 0.8 * np.sin((2 + 0.3 * order) * t[:, None] + order)
    azimuth = 0.7 * t[:, None] + 0.2 * order if space else np.zeros((samples, links))
    parts = [np.sin(opening) * np.cos(azimuth), np.sin(opening) * np.sin(azimuth), -np.cos(opening)]
    nodes = np.concatenate([np.zeros((samples, 1, 3)), np.cumsum(0.2 * np.stack(parts, -1), axis=1)], axis=1)
    velocities = np.gradient(nodes, dt, axis=0) if samples > 1 else np.zeros_like(nodes)
    scene = chain_of(links)
    return Samples(
        t=t,
        positions=nodes,
        velocities=velocities,
        tension=2.0 + np.cos(opening) + order[::-1],
        t_tension=np.maximum(t - dt / 2, 0),
        kinetic=np.exp(-t) * np.sin(t) ** 2,
        potential=np.exp(-t) * np.cos(t) ** 2,
        work=(np.exp(-t) - 1)[:, None],
        work_names=("linear_damping",),
        step_status=np.zeros(samples, int),
        status=status,
        scene=scene,
        settings={"integrator": "energy_momentum", "dt": dt},
    )


def check_picture(path, kind):
    with Image.open(path) as image:
        assert image.format == kind
        image.load()
        assert len(np.unique(np.asarray(image.convert("L")))) > 10
    assert path.stat().st_size > 1000


@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
@pytest.mark.parametrize("name", STILLS)
def test_stills_are_valid_pictures(tmp_path, name, space):
    path = getattr(plots, name)(run_of(80, space=space), tmp_path / f"{name}.png")
    assert path == tmp_path / f"{name}.png"
    check_picture(path, "PNG")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("samples", [1, 2, 3])
@pytest.mark.parametrize("name", [*STILLS, "animate"])
def test_runs_that_ended_at_once_are_drawn_too(tmp_path, name, samples):
    kind = "GIF" if name == "animate" else "PNG"
    path = getattr(plots, name)(run_of(samples, status="non_finite"), tmp_path / f"early.{kind.lower()}")
    check_picture(path, kind)


@pytest.mark.parametrize("name", ["angle_traces", "phase_space", "amplitude_spectrum"])
@pytest.mark.parametrize("links", [1, 30])
def test_one_link_and_many_links_are_drawn(tmp_path, name, links):
    getattr(plots, name)(run_of(20, links=links), tmp_path / "links.png")
    check_picture(tmp_path / "links.png", "PNG")


def test_chain_at_rest_is_drawn_without_warnings(tmp_path):
    run = run_of(10)
    run.positions[:] = run.positions[0]
    for field in (run.velocities, run.kinetic, run.potential, run.work, run.tension):
        field[:] = 0.0
    for name in STILLS:
        check_picture(getattr(plots, name)(run, tmp_path / f"{name}.png"), "PNG")
    plots.animate(run, tmp_path / "rest.gif")


@pytest.mark.parametrize("name", [*STILLS, "animate"])
def test_run_that_blew_up_is_drawn_up_to_there(tmp_path, name):
    run = run_of(30, status="non_finite")
    for field in (run.positions, run.velocities, run.tension, run.kinetic, run.potential):
        field[20:] *= np.logspace(20, 300, 10).reshape(-1, *[1] * (field.ndim - 1))
        field[27] = np.inf
        field[28:] = np.nan
    path = getattr(plots, name)(run, tmp_path / "blown.gif" if name == "animate" else tmp_path / "blown.png")
    assert path.stat().st_size > 1000
    assert len(readable(run).t) == 20


def test_snapshot_takes_a_time_and_the_suffix_chooses_the_format(tmp_path):
    path = plots.snapshot(run_of(40), tmp_path / "pose.svg", time=0.5)
    assert "<svg" in path.read_text()[:1000]
    assert plots.snapshot(run_of(40), str(tmp_path / "pose.png"), time=99.0).exists()


@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
def test_animation_plays_all_frames_and_reports_progress(tmp_path, space):
    reported = []
    path = plots.animate(
        run_of(21, space=space), tmp_path / "motion.gif", fps=10, progress=lambda done, what: reported.append(done)
    )
    with Image.open(path) as image:
        # 1 s of motion at 10 frames per second, both ends included.
        assert (image.format, image.n_frames, image.info["duration"]) == ("GIF", 11, 100)
        first = np.asarray(image.convert("RGB"))
        image.seek(10)
        assert (first != np.asarray(image.convert("RGB"))).any()
        assert (first[0, 0] == 255).all()
    assert len(reported) == 11
    assert reported == sorted(reported)
    assert reported[-1] == 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["motion.gif"]


def test_a_name_with_dollars_is_drawn_as_it_is(tmp_path):
    solution = run_of(12)
    odd = dataclasses.replace(solution, scene=Scene.from_dict(solution.scene.to_dict() | {"name": "a$b^{c$d"}))
    check_picture(plots.snapshot(odd, tmp_path / "pose.png"), "PNG")
    check_picture(plots.animate(odd, tmp_path / "motion.gif", fps=4), "GIF")


def test_logarithmic_axes_keep_their_powers_of_ten(tmp_path):
    figure = figures.new_figure(4.0, 3.0)
    axes = figure.subplots()
    axes.set_title("5 $ to 7 $")
    axes.loglog([1.0, 1e6], [1.0, 1e6])
    figures.save(figure, tmp_path / "log.png")
    assert not axes.title.get_parse_math()
    assert all(label.get_parse_math() for label in axes.get_xticklabels())


def test_a_long_title_ends_within_the_picture_and_the_legend_above_the_foot(tmp_path, monkeypatch):
    solution = run_of(12)
    named = solution.scene.to_dict() | {"name": "a dropper with a name that is longer than most are"}
    drawn = []
    monkeypatch.setattr(figures, "save", lambda figure, path: drawn.append(figure) or path)
    plots.snapshot(dataclasses.replace(solution, scene=Scene.from_dict(named)), tmp_path / "pose.png")
    figure = drawn[0]
    renderer = figure.canvas.get_renderer()
    title, foot = (text.get_window_extent(renderer) for text in figure.texts)
    assert title.x1 < figure.bbox.x1
    legend = figure.legends[0].get_window_extent(renderer)
    assert legend.y0 >= foot.y1
    assert legend.y1 <= figure.axes[0].get_tightbbox(renderer).y0


def test_long_motion_is_thinned_out_and_small(tmp_path):
    path = plots.animate(run_of(5001, links=7, dt=0.01), tmp_path / "long.gif")
    with Image.open(path) as image:
        assert 200 <= image.n_frames <= 250
    assert path.stat().st_size < 4e6


def test_animation_shows_only_the_seconds_asked_for(tmp_path):
    with Image.open(plots.animate(run_of(100), tmp_path / "part.gif", fps=20, seconds=1.0)) as image:
        assert image.n_frames == 21


@pytest.mark.parametrize("wrong", [{"fps": 0}, {"seconds": -1.0}])
def test_animation_refuses_what_is_not_positive(tmp_path, wrong):
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}"):
        plots.animate(run_of(5), tmp_path / "never.gif", **wrong)


def test_nothing_is_left_behind_and_the_old_file_stays_when_writing_fails(tmp_path):
    def stop(done, what):
        raise KeyboardInterrupt

    path = tmp_path / "motion.gif"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        plots.animate(run_of(20), path, progress=stop)
    assert path.read_bytes() == b"old"
    with pytest.raises(ValueError, match="not supported"):
        plots.snapshot(run_of(20), tmp_path / "pose.nonsense")
    assert [p.name for p in tmp_path.iterdir()] == ["motion.gif"]


def test_callers_matplotlib_settings_are_untouched(tmp_path):
    with matplotlib.rc_context({"font.size": 3.5, "axes.grid": False}):
        before = dict(matplotlib.rcParams)
        plots.energy_balance(run_of(5), tmp_path / "energy.png")
        assert dict(matplotlib.rcParams) == before


def test_planar_motion_is_distinguished_from_motion_in_space():
    assert view.planar(run_of(10).positions)
    assert view.planar(run_of(10).positions + np.array([0.0, 3.0, 0.0]))
    assert not view.planar(run_of(10, space=True).positions)


def test_an_mp4_without_ffmpeg_is_refused_before_anything_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SceneError, match=r"needs ffmpeg.*allowed: \.gif"):
        plots.animate(run_of(5), tmp_path / "motion.mp4")
    with pytest.raises(SceneError, match=r"allowed: \.gif, \.mp4"):
        plots.animate(run_of(5), tmp_path / "motion.mkv")


def stand_in(folder, text):
    """A program named ffmpeg."""
    program = folder / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\nimport sys\ndata = sys.stdin.buffer.read()\n{text}\n")
    program.chmod(0o755)
    return str(program.parent)


def test_an_mp4_gets_every_frame_whole(tmp_path, monkeypatch):
    # a stand-in that keeps the number of bytes and its arguments, since few machines have the real one
    keep = "open(sys.argv[-1], 'w').write(' '.join([str(len(data)), *sys.argv[1:-1]]))"
    monkeypatch.setenv("PATH", stand_in(tmp_path, keep))
    path = plots.animate(run_of(21), tmp_path / "motion.mp4", fps=10)
    count, *reported = path.read_text().split()
    width, height = map(int, reported[reported.index("-s") + 1].split("x"))
    frames = int(count) / (3 * width * height)
    with Image.open(plots.animate(run_of(21), tmp_path / "motion.gif", fps=10)) as gif:
        assert frames == gif.n_frames
        assert gif.size == (width, height)
    assert reported[reported.index("-r") + 1] == "10"


def test_an_encoder_that_fails_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", stand_in(tmp_path, "sys.exit('no such codec')"))
    with pytest.raises(OSError, match="ffmpeg failed: no such codec"):
        plots.animate(run_of(5), tmp_path / "motion.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["bin"]


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_a_real_mp4_can_be_read_back(tmp_path):
    video = pytest.importorskip("cv2").VideoCapture(str(plots.animate(run_of(21), tmp_path / "motion.mp4", fps=10)))
    assert video.isOpened()
    assert video.read()[0]


@pytest.mark.parametrize("sideways", [0.0, 1.5], ids=["plane", "space"])
@pytest.mark.parametrize("name", ["snapshot", "under_surface", "tension_envelope", "angle_traces"])
def test_systems_of_lines_are_drawn(longline, tmp_path, name, sideways):
    check_picture(getattr(plots, name)(longline(sideways), tmp_path / "system.png"), "PNG")


@pytest.mark.parametrize("sideways", [0.0, 1.5], ids=["plane", "space"])
def test_animation_of_a_system_moves_its_water_and_buoys(longline, tmp_path, sideways):
    path = plots.animate(longline(sideways, samples=11), tmp_path / "system.gif", fps=10)
    with Image.open(path) as image:
        assert image.n_frames == 11
        blue = [np.argwhere(_near(image, seek, (86, 180, 233))).shape[0] for seek in (0, 8)]
        orange = [np.argwhere(_near(image, seek, (230, 159, 0))).mean(axis=0) for seek in (0, 8)]
    assert min(blue) > 50
    assert np.abs(orange[1] - orange[0]).max() > 1.0


def _near(image, frame, colour):
    image.seek(frame)
    return np.abs(np.asarray(image.convert("RGB"), int) - colour).max(axis=-1) < 12


def test_links_and_angles_of_a_system_stay_within_their_lines(longline):
    solution = longline()
    run = readable(solution)
    segments = run.segments(run.positions[7])
    assert len(segments) == len(run.labels) == 17
    assert run.labels[4] == "backbone 1"
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    assert length.max() < 12.0  # a link from one line's end to the next one's start would be 30 m or more
    np.testing.assert_array_equal(run.angles[0], solution.polar)
    places = run.positions[7][list(run.fixed_nodes)]
    np.testing.assert_array_equal(places, [[-40, 0, -20], [40, 0, -20]])


def test_a_colour_bar_shows_where_it_ends_below_the_largest_tension():
    """Of 1000 tensions 1, 2, ..., 1000 the colours end at the 1st and 99th percentile."""
    tension = np.arange(1.0, 1001.0)
    for values, extend, label in (
        (tension, "both", "tension [N], maximum 1000"),
        (np.ones(2), "neither", "tension [N]"),
    ):
        figure = matplotlib.figure.Figure()
        shown = matplotlib.cm.ScalarMappable(tension_colours.tension_norm(values), tension_colours.tension_map())
        tension_colours.tension_bar(figure, shown, values, ax=figure.subplots())
        assert (shown.colorbar.extend, shown.colorbar.ax.get_ylabel()) == (extend, label)


def _ink(figure, shown):
    """Where (height, width) the picture has ink if only these artists of all texts are visible."""
    hidden = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text not in shown]
    for text in hidden:
        text.set_visible(False)
    figure.canvas.draw()
    for text in hidden:
        text.set_visible(True)
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].min(axis=-1)


@pytest.mark.parametrize("sides", [(100, 30, 40), (12, 90, 25), (25, 25, 100), (0.13, 0.13, 0.32), (1, 1, 1)])
def test_names_and_ticks_of_axes_in_space_are_visible_and_apart(sides):
    figure = figures.new_figure(4, 4, layout=None)
    with style.plot_style():
        axes = space_axes(figure, np.outer(sides, [-0.45, 0.55]))
        figure.colorbar(matplotlib.cm.ScalarMappable(), cax=bar_axes(figure), label="tension [kN]")
    figure.canvas.draw()
    kinds = [(axis, [tick.label1 for tick in axis.get_major_ticks()]) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    bare = _ink(figure, [])
    names = [text for text in figure.texts if text.get_text() in ("x [m]", "y [m]", "z [m]")]
    assert len(names) == 3
    layers = [_ink(figure, [name]) != bare for name in names] + [_ink(figure, labels) != bare for _, labels in kinds]
    for layer in layers:
        assert layer.sum() > 20
        edges = np.concatenate([layer[0], layer[-1], layer[:, 0], layer[:, -1]])
        assert not edges.any()  # whole
        assert bare[layer].min() > 200  # beside lines, edges and the colour bar
    assert np.sum(layers, axis=0).max() == 1  # none over another


def test_envelopes_of_similar_loads_have_one_scale():
    figure = matplotlib.figure.Figure()
    panels = list(figure.subplots(5))
    for axes, top in zip(panels, (19.0, 0.4, 15.0, 1.3, 0.5), strict=True):
        axes.set_ylim(-0.05 * top, top)
    scales.share_scales(panels)
    similar = [19.0, 1.3, 19.0, 1.3, 1.3]
    np.testing.assert_allclose([axes.get_ylim() for axes in panels], np.outer(similar, [-0.05, 1.0]))


def test_panels_far_apart_share_the_scale_and_close_ones_the_limits():
    axes = Figure().subplots(3)
    for panel, limits in zip(axes, [(132.0, 134.0), (-1.0, 0.5), (0.0, 1.0)], strict=True):
        panel.set_ylim(*limits)
    scales.share_scales(axes)
    assert [np.mean(panel.get_ylim()) for panel in axes] == pytest.approx([133.0, -0.25, 0.5])
    assert [np.ptp(panel.get_ylim()) for panel in axes] == pytest.approx([2.0, 2.0, 2.0])
    scales.share_scales(axes[1:])
    assert axes[1].get_ylim() == axes[2].get_ylim() == pytest.approx((-1.25, 1.5))
