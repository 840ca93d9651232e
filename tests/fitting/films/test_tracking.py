"""`dropper track` on videos rendered from simulated runs, whose angles are known."""

import json
import re

import films
import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.cli import main
from fitting import Motion, View, film, fit, read_trace, write_video
from fitting.films import track
from fitting.films.calibration import calibrate
from fitting.films.render import chessboards
from fitting.films.video import opencv

FPS, FRAMES = 60.0, 130
#: Node 3 is covered for 10 frames; nodes 5 and 6 swing behind a post, in part and as a whole.
LAB = View(
    bending=(-0.12, 0.05), centre=(0.14, -0.14), distance=1.1, hidden=((3, 60, 69),), post=(0.30, 0.010), noise=5.0
)


def true_angles(places):
    """Angle of each link, counter-clockwise from the right, by the cumulative turn between samples."""
    direction = np.diff(places, axis=1) @ [1.0, 1j]
    turn = np.angle(direction[1:] / direction[:-1])
    return np.concatenate([np.angle(direction[:1]), np.angle(direction[:1]) + np.cumsum(turn, axis=0)])


def run_of(scene, duration):
    """A run sampled finer than the film, which needs places within an exposure."""
    solution = dj.simulate(scene, duration=duration, dt=1 / 480, integrator="rattle")
    return Motion(solution.t, solution.positions)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A filmed release of the lab dropper, boards, and its true angles."""
    folder = tmp_path_factory.mktemp("lab")
    motion = run_of("dropper-release-a", (FRAMES - 1) / FPS)
    write_video(folder / "lab.avi", film(motion, LAB, FPS), FPS)
    boards = films.save_images(folder, chessboards(LAB, count=6))
    return folder, boards, true_angles(motion.nodes[:: round(480 / FPS), :, [0, 2]])


@pytest.fixture(scope="module")
def tracked_lab(lab):
    folder, boards, _ = lab
    call = ["track", str(folder / "lab.avi"), "--nodes", "8", "--calibration", *boards, "--plane", boards[0]]
    for option, name in (("--out", "traces.csv"), ("--positions", "places.csv"), ("--overlay", "sheet.png")):
        call += [option, str(folder / name)]
    code = main([*call, "--square", "0.03", "--quiet", "--json"])
    return code, read_trace(folder / "traces.csv")


@pytest.mark.check
def test_angles_from_video_are_within_a_fifth_of_a_degree_and_no_node_is_swapped(lab, tracked_lab):
    code, trace = tracked_lab
    truth = lab[2]
    assert code == 0
    assert trace.theta.shape == truth.shape
    error = np.rad2deg(trace.theta - truth)
    assert np.sqrt(np.nanmean(error**2, axis=0)).max() < 0.2
    # a swapped or mirrored link would be off by tens of degrees
    assert np.nanmax(np.abs(error)) < 1.5
    assert np.isfinite(error).mean() > 0.9


@pytest.mark.check
def test_a_covered_marker_is_left_empty_and_found_again(tracked_lab):
    _, trace = tracked_lab
    assert np.isnan(trace.theta[60:70, 2:4]).all()
    assert np.isnan(trace.se[60:70, 2:4]).all()
    assert np.isfinite(trace.theta[70:75, 2:4]).all()
    assert np.isfinite(trace.theta[60:70, :2]).all()


def test_standard_errors_are_the_scatter_of_the_angles(lab, tracked_lab):
    _, trace = tracked_lab
    off = trace.theta - lab[2]
    # what stays for long (the level, the rest of the lens) is no scatter: differences from one sample to the next
    scatter = np.nanstd(np.diff(off[:, :4], axis=0), axis=0) / np.sqrt(2)
    assert np.all(scatter < 2 * np.nanmedian(trace.se[:, :4], axis=0))
    assert np.all(scatter > 0.3 * np.nanmedian(trace.se[:, :4], axis=0))


def test_the_files_name_the_convention_the_metres_and_what_was_not_seen(lab, tracked_lab):
    folder = lab[0]
    lines = (folder / "traces.csv").read_text().splitlines()
    assert lines[0] == "# zero=horizontal, sign=-1, unit=rad"
    assert lines[1].split(",") == ["t", *(f"theta_{j}" for j in range(1, 8)), *(f"se_{j}" for j in range(1, 8))]
    places = np.genfromtxt(folder / "places.csv", delimiter=",", comments="#", skip_header=2)
    assert not places[60:70, 3 * 3 + 3].any()
    # the ends hang 0.28 m apart at one height, through any lens
    np.testing.assert_allclose(places[:, 22] - places[:, 1], 0.28, atol=1e-3)
    np.testing.assert_allclose(places[:, 23] - places[:, 2], 0.0, atol=1e-3)
    sheet = opencv().imread(str(folder / "sheet.png"))
    assert sheet.shape[1] > 1500
    assert np.ptp(sheet) == 255


def test_the_lens_is_recovered_from_boards(lab):
    lens = calibrate(lab[1])
    assert lens.error < 0.3
    np.testing.assert_allclose(lens.matrix[[0, 1], [0, 1]], LAB.focus, rtol=0.01)
    # the image of a point at the edge says more than the coefficients, which compensate each other
    edge = np.array([[20.0, 20.0], [620.0, 240.0], [320.0, 460.0]])
    np.testing.assert_allclose(lens.straighten(edge), LAB.lens.straighten(edge), atol=1.5)
    np.testing.assert_allclose(lens.bend(lens.straighten(edge)), edge, atol=1e-3)


@pytest.mark.check
def test_markers_that_pass_each_other_keep_their_names(tmp_path):
    # links 1 and 2 fold like a knife, so that node 2 passes over node 0, and node 3 over node 1
    t = np.arange(0, 1.5, 1 / 240)
    first = -1.2 + 0.5 * np.sin(4 * t)
    theta = np.stack([first, first + np.pi - 1.5 * np.cos(3 * t), first - 1.0 * np.cos(3.0 * t)], axis=1)
    link = 0.1 * np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    nodes = np.concatenate([np.zeros((len(t), 1, 3)), np.cumsum(link, axis=1)], axis=1)
    apart = np.linalg.norm(nodes[:, 2] - nodes[:, 0], axis=1).min()
    view = View(size=(320, 280), focus=600.0, centre=(0.0, -0.05), radius=0.008)
    assert apart < view.radius / 2
    write_video(tmp_path / "fold.avi", film(Motion(t, nodes), view, FPS), FPS)
    found = track(tmp_path / "fold.avi", 4)
    truth = true_angles(nodes[::4][:, :, [0, 2]])
    assert found.status == "ok"
    error = found.trace.theta - truth[: len(found.trace.t)]
    assert np.nanmax(np.abs(np.rad2deg(error))) < 4.0
    assert np.isfinite(error).mean() > 0.8


PAIR = rods([1.0, 1.0], 0.2, 0.05, {"linear_damping": {"b_l": 0.02}, "quadratic_damping": {"b_q": 0.02}})


@pytest.mark.check
def test_a_video_gives_the_damping_within_five_per_cent(tmp_path):
    view = View(size=(300, 290), focus=460.0, centre=(0.0, -0.22), radius=0.012)
    write_video(tmp_path / "pair.avi", film(run_of(PAIR, 4.0), view, FPS), FPS)
    assert main(["track", str(tmp_path / "pair.avi"), "--nodes", "3", "--out", str(tmp_path / "a.csv"), "--quiet"]) == 0
    effects = {"weight": {}, "linear_damping": {"b_l": 0.06}, "quadratic_damping": {"b_q": 0.005}}
    result = fit(tmp_path / "a.csv", PAIR | {"effects": effects}, method="windows")
    assert result.status == "ok"
    damping = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]  # a scale of lengths and the zero follow
    assert [p.name for p in result.parameters[:2]] == damping
    np.testing.assert_allclose(result.values[:2], [0.02, 0.02], rtol=0.05)
    # the tracked errors are the fit's weights: a fair chi-square says that they are neither too small nor too large
    assert 0.5 < result.chi2_per_dof < 2.0


def ended(capsys, *arguments):
    """Exit code, object and lines of a tracking that keeps what came before it stopped."""
    code = main(["track", *map(str, arguments), "--json", "--quiet"])
    out, err = capsys.readouterr()
    return code, json.loads(out), err.splitlines()


def spots(count, frames=12):
    """Frames with white discs in a row that swing together."""
    y = 60 + 10 * np.sin(0.3 * np.arange(frames))
    places = np.stack(np.broadcast_arrays(25.0 + 30.0 * np.arange(count), y[:, None]), axis=-1)
    return films.discs(places, 6.0, (160, 120), noise=0.0)


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    (folder / "text.mp4").write_text("this is no video\n" * 50)
    (folder / "empty.avi").write_bytes(b"")
    write_video(folder / "three.avi", spots(3), FPS)
    write_video(folder / "none.avi", films.discs(np.zeros((30, 0, 2))), FPS)
    films.save_images(folder, chessboards(View(), count=2))
    return folder


@pytest.mark.parametrize(
    ("video", "more", "words"),
    [
        ("missing.avi", ["--nodes", "3"], "no such video"),
        ("text.mp4", ["--nodes", "3"], "cannot be read as a video"),
        ("empty.avi", ["--nodes", "3"], "cannot be read as a video"),
        ("none.avi", ["--nodes", "4"], "none.avi: no circles"),
        ("three.avi", ["--nodes", "5"], "at most 3 circles in a frame, but 5 nodes"),
        ("three.avi", ["--nodes", "1"], "at least 2"),
        ("three.avi", ["--nodes", "3", "--scale", "-1"], "--scale: -1 is out of range"),
        ("three.avi", ["--nodes", "3", "--scale", "1", "--distance", "1"], "allowed: one of them"),
        ("three.avi", ["--nodes", "3", "--board", "9"], "COLUMNSxROWS"),
        ("three.avi", ["--nodes", "3", "--start", "25,60", "55,60", "5,5"], "near node 2"),
        ("three.avi", ["--nodes", "3", "--calibration", "board-0.png", "board-1.png"], "found in 2 of 2 pictures"),
        ("three.avi", ["--nodes", "3", "--calibration", "text.mp4"], "cannot be read as an image"),
        ("three.avi", ["--nodes", "3", "--plane", "board-0.png"], "--square: missing"),
        ("three.avi", ["--nodes", "3", "--plane", "board-0.png", "--square", "0.03"], "(160, 120), those of the video"),
        ("three.avi", ["--nodes", "3", "--from", "0.1", "--until", "0.101"], "no frame is between 0.1 and 0.101 s"),
    ],
)
def test_what_a_user_can_correct_is_one_line_and_exit_code_2(bad, refused, monkeypatch, video, more, words):
    monkeypatch.chdir(bad)
    assert words in refused(["track", video, *more, "--quiet"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"scale": -1.0}, "--scale: -1; allowed: a number > 0"),
        ({"distance": np.nan}, "--distance: nan; allowed"),
        ({"fps": 0.0}, "--fps: 0; allowed"),
        ({"first": "bottom"}, "--first: 'bottom' is unknown; allowed: auto, left, right, top"),
        ({"begin": np.nan}, "--from, --until: nan to None s"),
        ({"end": np.inf}, "--from, --until: 0 to inf s"),
    ],
)
def test_values_from_python_are_checked_as_those_of_the_command(bad, given, words):
    with pytest.raises(SceneError, match=words):
        track(bad / "three.avi", 3, **given)


def test_a_calibration_with_an_error_above_one_pixel_is_refused(tmp_path, refused, bad):
    # pictures on paper that waves: no lens bends like that
    y, x = np.mgrid[:480, :640].astype(np.float32)
    wave = (x + 4 * np.sin(y / 30), y + 4 * np.sin(x / 40))
    paths = films.save_images(tmp_path, (opencv().remap(b, *wave, 1) for b in chessboards(View(), count=5)))
    line = refused(["track", str(bad / "three.avi"), "--nodes", "3", "--quiet", "--calibration", *map(str, paths)])
    assert re.search("reprojection error .*at most 1", line)


def test_boards_of_another_size_than_the_video_are_refused(lab, bad, refused):
    assert "(640, 480)" in refused(["track", str(bad / "three.avi"), "--nodes", "3", "--calibration", *lab[1]])


def test_an_overlay_takes_the_frame_rate_that_the_file_lacks(tmp_path, monkeypatch):
    write_video(tmp_path / "three.avi", spots(3, 60), FPS)
    monkeypatch.setattr(opencv(), "CAP_PROP_FPS", -1)  # a property that no file has
    call = ["track", str(tmp_path / "three.avi"), "--nodes", "3", "--out", str(tmp_path / "three.csv"), "--quiet"]
    assert main(call) == 2
    assert main([*call, "--fps", f"{FPS:g}", "--overlay", str(tmp_path / "sheet.png")]) in (0, 3)
    assert (tmp_path / "sheet.png").is_file()


def test_a_marker_lost_for_good_keeps_what_came_before_and_exits_with_3(tmp_path, capsys):
    # 30 good frames, then 40 in which the middle disc is gone
    frames = list(spots(3, 70))
    for image in frames[30:]:
        image[:, 40:70] = 60
    write_video(tmp_path / "gone.avi", frames, FPS)
    code, found, lines = ended(capsys, tmp_path / "gone.avi", "--nodes", 3, "--out", tmp_path / "gone.csv")
    assert code == 3
    assert found["status"] == "not_converged"
    assert "marker 1 is lost after 0.5 s" in found["error"]
    assert len([line for line in lines if line.startswith("error")]) == 1
    assert len(read_trace(tmp_path / "gone.csv").t) == 30


def test_a_video_that_breaks_off_keeps_what_came_before_and_exits_with_3(tmp_path, capsys):
    write_video(tmp_path / "whole.avi", spots(3, 60), FPS)
    data = (tmp_path / "whole.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    code, found, _ = ended(capsys, tmp_path / "cut.avi", "--nodes", 3, "--out", tmp_path / "cut.csv")
    assert code == 3
    assert "breaks off" in found["error"]
    assert 10 < len(read_trace(tmp_path / "cut.csv").t) < 50
