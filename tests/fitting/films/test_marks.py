"""What is wrong is found with its time, what is right left alone; slant and exposure are found from the lengths."""

import films
import numpy as np
import pytest

from dropper_jax import SceneError
from fitting import View, wrap
from fitting.films.calibration import Plane
from fitting.films.exposure import exposure_share, second_differences
from fitting.films.flat_map import Flat
from fitting.films.flattening import flatten
from fitting.films.link_angles import estimate_angle_errors, four_quadrant
from fitting.films.marks import find_marks


@pytest.mark.parametrize("name", ["loop, slanting camera", "chain, slanting camera"])
def test_swapped_and_shifted_nodes_are_found_and_others_are_not(name):
    found = films.spoiled(films.FILMS[name], draws=12, seed=3)
    assert found["swapped_found"] >= 0.95 * found["swapped"] > 50
    assert found["jumped_found"] >= 0.95 * found["jumped"] > 10
    assert found["well_marked"] <= 0.01 * found["well"]


def test_marks_name_times_and_nodes():
    film = films.FILMS["chain, blurred"]
    places = film.positions() * 600.0
    places[60:72, [1, 3]] = places[60:72, [3, 1]]
    t = np.arange(len(places)) / 60
    (span,) = find_marks(places, np.ones(places.shape[:2], bool)).spans(t)
    assert (span["from_s"], span["to_s"]) == pytest.approx((1.0, 71 / 60))
    assert {1, 3} <= set(span["nodes"])
    assert "swapped" in span["why"]


def test_slant_and_bending_are_found_from_the_lengths_alone():
    motion = films.FILMS["loop, slanting camera"].positions()
    view = View(slant=(0.13, -0.07), bending=(-0.12, 0.05), centre=(0.14, -0.1), distance=0.7)
    pixels = np.stack([view.to_pixels(each) for each in motion])
    pixels += 0.05 * np.random.default_rng(0).standard_normal(pixels.shape)
    found = flatten(pixels, Flat(view.size), 60.0)
    np.testing.assert_allclose(found.parameters[:2], view.slant, atol=0.005)
    link = np.diff(motion, axis=1)
    truth = np.arctan2(link[..., 1], link[..., 0])
    off = [wrap(four_quadrant(to(pixels) * [1.0, -1.0]) - truth) for to in (Flat(view.size), found)]
    raw, rms = (np.sqrt(np.mean(each**2)) for each in off)
    assert rms < 1.2e-3 < 5e-3 < raw
    np.testing.assert_allclose(found.back(found(pixels[:3])), pixels[:3], atol=1e-6)


def test_a_pixel_beyond_the_horizon_has_no_position_and_a_point_behind_the_camera_no_pixel():
    """A camera 1 m above a level plane, 100 pixels per unit of slope: row y below the horizon sees 100/y m ahead."""
    level = Plane(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 100.0], [0.0, 1.0, 0.0]]))
    seen = level.to_metres(np.array([[50.0, 200.0], [50.0, 0.0], [50.0, -200.0]]))
    np.testing.assert_array_equal(seen, [[0.25, 0.5], [np.nan] * 2, [np.nan] * 2])
    view = View(slant=(1.2, 0.0))  # a point x to the right is at the depth 1 m - x sin 1.2
    assert np.isfinite(view.to_pixels(np.array([[1.07, 0.0], [-1.07, 0.0]]))).all()
    with pytest.raises(SceneError, match="a point is 0.0066 m behind the camera"):
        view.to_pixels(np.array([[0.0, 0.0], [1.08, 0.0]]))


@pytest.mark.parametrize("noise", [0.01, films.NOISE])
def test_the_exposure_is_found_from_the_lengths_and_taken_back(noise):
    fine = films.FILMS["chain, blurred"].motion().nodes[..., [0, 2]] * 900.0
    # the mean over the middle half of a frame, by the fine samples of it (trapezoid over 5)
    weight = np.array([0.5, 1, 1, 1, 0.5]) / 4
    middle = np.arange(8, len(fine) - 8, films.FINE)
    sharp = fine[middle]
    scatter = noise * np.random.default_rng(1).standard_normal(sharp.shape)
    blurred = sum(w * fine[middle + s] for w, s in zip(weight, (-2, -1, 0, 1, 2), strict=True)) + scatter
    share = exposure_share(blurred)
    # the mean square of the trapezoid's offsets (0, +-1, +-2 eighths of a frame) is 1.5/64; half of it goes with D
    assert share == pytest.approx(0.5 * 1.5 / 64, rel=0.1)
    corrected = blurred - share * second_differences(blurred)
    left, before = (np.sqrt(np.mean((each - sharp - scatter)[1:-1] ** 2)) for each in (corrected, blurred))
    assert left < 0.5 * before
    # sharp pictures show none, also of a chain that swings out of the plane by 0.1 rad
    lower = np.cos(0.1 * np.sin(0.13 * np.arange(len(middle))))[:, None]
    for height in (1.0, lower):
        assert exposure_share(np.stack([sharp[..., 0], height * sharp[..., 1]], axis=-1) + scatter) == 0.0


def test_the_scatter_of_lengths_gives_the_errors_of_angles():
    rng = np.random.default_rng(2)
    turn = np.linspace(0, 9, 400)
    truth = np.stack([np.zeros((400, 2)), 70 * np.stack([np.cos(turn), np.sin(turn)], axis=1)], axis=1)
    places = truth + 0.2 * rng.standard_normal(truth.shape)
    off = four_quadrant(places) - four_quadrant(truth)
    # the edges of the circles would have shown a quarter of it
    found = estimate_angle_errors(places, np.full((400, 2), 0.05), np.ones((400, 1), bool))
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.15)
