"""`dropper track` on films of point masses on rigid links, integrated by SciPy from equations of their own."""

import json
import warnings

import films
import numpy as np
import pytest

from dropper_jax.cli import main
from fitting import read_trace, wrap, write_video
from fitting.films import track
from fitting.films.video import opencv


def test_point_masses_keep_their_lengths_and_swing_as_a_pendulum_does():
    # one mass on one link: a pendulum of small swing, whose period is 2 pi sqrt(l/g)
    angle = 0.02
    start = np.array([[0.0, 0.0, 0.0], [0.25 * np.sin(angle), 0.0, -0.25 * np.cos(angle)]])
    t = np.linspace(0.0, 2 * np.pi * np.sqrt(0.25 / 9.81), 101)
    swing = films.point_masses(start, False, t, damping=0.0)
    np.testing.assert_allclose(swing[:, 1, 0], start[1, 0] * np.cos(2 * np.pi * t / t[-1]), atol=2e-5 * 0.25)
    loop = films.FILMS["loop, blurred"].motion().nodes
    np.testing.assert_allclose(np.linalg.norm(np.diff(loop, axis=1), axis=-1), 0.1, atol=1e-8)


@pytest.mark.check
@pytest.mark.parametrize("name", films.FILMS)
def test_all_films_are_tracked_with_boards_and_without(tmp_path, name):
    film = films.FILMS[name]
    path, boards, truth = films.make(film, tmp_path)
    for given, limit in ((boards, 2.0), ([], 5.0)):
        found = films.judged(film, path, given, truth)
        assert (found["status"], found["first_frame"], found["right_order"]) == ("ok", 0, True)
        assert found["rms_mrad"] < limit
        assert 0.7 < found["stated_over_true"] < 1.5
        assert found["marked_share"] <= 0.01


def test_an_unknown_order_is_exit_3_with_a_picture_and_start_decides_it(tmp_path, printed):
    places = np.array([160.0, 120.0]) + films.stiff_zigzag(0.5 * np.sin(np.arange(50) / 10))
    write_video(tmp_path / "stiff.avi", films.discs(places), 60.0)
    out = tmp_path / "a.csv"
    call = ["track", str(tmp_path / "stiff.avi"), "--nodes", "4", "--out", str(out), "--json", "--quiet"]
    output, errors = printed(call, 3)
    found = json.loads(output)
    assert found["status"] == "ambiguous_order"
    assert not out.exists()
    assert len([line for line in errors.splitlines() if line.startswith("error")]) == 1
    picture = opencv().imread(found["picture"])
    assert picture.shape[1] > 1500  # three orders side by side
    # the first order is drawn over the discs: links in blue there where the film is grey
    assert (picture[..., 0].astype(int) - picture[..., 2] > 80).sum() > 1000
    named = [f"{x:.0f},{y:.0f}" for x, y in places[0]]
    assert main([*call, "--start", *named]) == 0
    link = np.diff(places, axis=1)
    truth = np.unwrap(np.arctan2(-link[..., 1], link[..., 0]), axis=0)
    np.testing.assert_allclose(read_trace(out).theta, truth, atol=0.01)


def test_a_disc_that_jumps_for_three_frames_is_marked_with_its_time(tmp_path):
    # a double pendulum whose last disc is somewhere else in frames 40 to 42
    t = np.arange(90) / 60
    one, two = 0.8 * np.sin(5 * t), 0.9 * np.sin(7 * t + 1)
    links = [70 * np.stack([np.sin(a), np.cos(a)], axis=1) for a in (one, two)]
    places = np.cumsum(np.stack([np.full((90, 2), (160.0, 40.0)), *links], axis=1), axis=1)
    turned = places.copy()
    turned[40:43, 2] = places[40:43, 1] + 70 * np.array([np.cos(0.3), -np.sin(0.3)])
    write_video(tmp_path / "leap.avi", films.discs(turned), 60.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = track(tmp_path / "leap.avi", 3)
    # not followed there, or marked: never passed on
    assert np.isnan(found.trace.theta[40:43, 1]).all()
    assert np.isfinite(found.trace.theta[:, 0]).all()
    kept = np.r_[0:39, 44:90]
    truth = np.arctan2(-links[1][:, 1], links[1][:, 0])
    assert np.abs(wrap(found.trace.theta[kept, 1] - truth[kept])).max() < 0.01
