"""Circles that do not move as the nodes of a chain are `lost`, and nothing is written."""

import json

import films
import numpy as np
import pytest

from dropper_jax.cli import main
from fitting import write_video
from fitting.films.chain_check import why_no_chain
from fitting.films.marks import find_marks
from fitting.films.video import opencv

LENGTH = 100.0


def why(positions, error=0.003):
    detected = np.ones(positions.shape[:2], bool)
    errors = np.full((len(positions), positions.shape[1] - 1), error)
    return why_no_chain(positions, find_marks(positions, detected), errors)


def pendulum(phase):
    """A fixed point and a node that swings by 0.5 rad, at these phases (k,), with the noise of circles."""
    angle = 0.5 * np.sin(phase)
    swing = LENGTH * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    noise = np.random.default_rng(0).normal(0, 0.05, (len(phase), 2, 2))
    return np.stack([np.zeros_like(swing), swing], axis=1) + noise


@pytest.mark.parametrize("samples", [6, 10, 60])
def test_a_swing_with_six_samples_or_more_is_one_of_a_chain(samples):
    assert why(pendulum(2 * np.pi * np.arange(120) / samples)) == ""


def test_circles_at_the_right_distance_that_jump_are_none():
    """A different pair of spots in each frame, always a link apart: their length alone does not reveal them."""
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, 200)
    first = rng.uniform(0, 500, (200, 2))
    pair = np.stack([first, first + LENGTH * np.stack([np.sin(angle), np.cos(angle)], axis=-1)], axis=1)
    assert why(pair)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda p, t: p * (1 + 0.15 * np.sin(0.1 * t))[:, None, None], "changes its length by"),
        (lambda p, t: p[:1] + np.random.default_rng(2).normal(0, 0.3, p.shape), "no node moves"),
    ],
)
def test_links_that_stretch_and_spots_that_rest_are_no_chain(damage, words):
    t = np.arange(200)
    assert words in why(damage(pendulum(0.2 * t), t))


def test_a_standard_error_above_0_2_rad_is_never_ok():
    assert "standard error of 3e+03 rad" in why(pendulum(0.2 * np.arange(200)), 3e3)
    assert "standard error of 0.25 rad" in why(pendulum(0.2 * np.arange(200)), 0.25)
    assert why(pendulum(0.2 * np.arange(200)), 0.15) == ""


def test_two_circles_that_move_on_their_own_are_lost_with_exit_3_and_no_trace(tmp_path, printed):
    t = np.arange(90) / 60
    one = np.stack([110 + 3 * np.sin(7 * t), np.full(90, 30.0)], axis=-1)
    angle, apart = 0.6 * np.sin(5 * t), 90 * (1 + 0.12 * np.sin(4 * t))
    two = one + apart[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    write_video(tmp_path / "two.avi", films.discs(np.stack([one, two], axis=1), size=(220, 160), noise=0.0), 60.0)
    out = tmp_path / "two.csv"
    call = ["track", str(tmp_path / "two.avi"), "--nodes", "2", "--out", str(out)]
    output, errors = printed([*call, "--overlay", str(tmp_path / "o.png"), "--json", "--quiet"], 3)
    found = json.loads(output)
    assert found["status"] == "lost"
    assert found["out"] is None
    assert not out.exists()
    assert (tmp_path / "o.png").exists()
    (line,) = errors.splitlines()
    assert "the circles do not move as the nodes of a chain: link 1 changes its length" in line


@pytest.mark.check
def test_a_film_without_markers_is_lost(tmp_path, capsys):
    """A blob on a thread that cannot be seen, and a frame with edges and corners, 30 Hz."""
    cv2, rng = opencv(), np.random.default_rng(1)
    height, width = 960, 540
    base = 165 + rng.normal(0, 3, (height, width)) + np.linspace(15, -15, height)[:, None]
    base = np.clip(base, 0, 255).astype(np.uint8)
    cv2.rectangle(base, (30, 765), (495, 780), 40, -1)
    cv2.rectangle(base, (15, 105), (520, 112), 45, -1)
    for x in (15, 512):
        cv2.rectangle(base, (x, 105), (x + 8, 780), 45, -1)
    for x in range(0, width, 140):
        cv2.line(base, (x, 800), (x - 60, 959), 115, 2)

    def frames():
        for k in range(360):
            image, angle = base.copy(), 0.35 * np.exp(-k / 600) * np.cos(6.1 * k / 30)
            centre = (int(265 + 130 * np.sin(angle)), int(108 + 130 * np.cos(angle)))
            cv2.ellipse(image, centre, (13, 16), 0, 0, 360, 150, -1)
            cv2.ellipse(image, (centre[0] - 4, centre[1] - 4), (5, 6), 30, 0, 360, 215, -1)
            yield np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)

    write_video(tmp_path / "none.avi", frames(), 30.0)
    code = main(["track", str(tmp_path / "none.avi"), "--nodes", "2", "--out", str(tmp_path / "a.csv"), "--quiet"])
    output, _ = capsys.readouterr()
    assert code in (2, 3)
    assert code == 2 or "lost: no angles are written" in output
    assert not (tmp_path / "a.csv").exists()
