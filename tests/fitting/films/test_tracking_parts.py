"""Parts of tracking on their own: angles, circles, the order of the chain, identity."""

import numpy as np
import pytest

from fitting.films.detection import Circles, MarkerAppearance, detect, learn_appearance
from fitting.films.flattening import Flat
from fitting.films.following import follow_film
from fitting.films.identity import Follower
from fitting.films.link_angles import angle_errors, four_quadrant
from fitting.films.ordering import Chain
from fitting.films.video import Video


def thesis_angle(x0, y0, x1, y1):
    """Equations (7.1)-(7.4) as printed; x counts to the left, from the lower right corner of the picture."""
    if x0 > x1 and y0 > y1:
        return -np.arctan((y0 - y1) / (x0 - x1))
    if x0 < x1 and y0 > y1:
        return -(np.pi - np.arctan((y0 - y1) / (x1 - x0)))
    if x0 < x1 and y0 < y1:
        return np.pi - np.arctan((y1 - y0) / (x1 - x0))
    return np.arctan((y1 - y0) / (x0 - x1))


@pytest.mark.parametrize("direction", np.arange(0.1, 6.3, 0.37))
def test_the_angle_is_that_of_the_thesis_in_all_four_quadrants(direction):
    node, following = (
        np.array([0.2, 0.3]),
        np.array([0.2, 0.3]) + 0.15 * np.array([np.cos(direction), np.sin(direction)]),
    )
    left = 5.0  # width of the picture: x to the left is this less x to the right
    expected = thesis_angle(left - node[0], node[1], left - following[0], following[1])
    assert four_quadrant(np.stack([node, following])[None])[0, 0] == pytest.approx(expected)


def test_a_link_that_turns_twice_has_an_angle_that_goes_on():
    turn = np.linspace(0.3, 0.3 + 4 * np.pi, 200)
    places = np.stack([np.zeros((200, 2)), np.stack([np.cos(turn), np.sin(turn)], axis=1)], axis=1)
    np.testing.assert_allclose(four_quadrant(places)[:, 0], turn, atol=1e-12)


def test_the_error_of_an_angle_is_that_of_random_places():
    rng = np.random.default_rng(0)
    places = np.array([[0.0, 0.0], [60.0, 80.0]]) + 0.3 * rng.standard_normal((4000, 2, 2))
    expected = np.std(four_quadrant(places))
    assert angle_errors(np.array([[[0.0, 0.0], [60.0, 80.0]]]), np.full((1, 2), 0.3))[0, 0] == pytest.approx(
        expected, rel=0.05
    )


def disc_picture(centres, radius, cut=None, seed=0):
    y, x = np.mgrid[:150, :200]
    image = np.full((150, 200), 50.0)
    for cx, cy in centres:
        image += 170 * np.clip(0.5 + radius - np.hypot(x - cx, y - cy), 0, 1)
    if cut is not None:
        image[:, cut:] = 50
    noise = 4 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


CENTRES = np.array([[40.3, 40.7], [90.55, 80.2], [150.1, 60.9]])


@pytest.mark.parametrize("radius", [4.0, 8.0, 16.0])
def test_circles_are_found_to_a_twentieth_of_a_pixel_whatever_their_size(radius):
    image = disc_picture(CENTRES, radius)
    look = learn_appearance(image, 3)
    found = detect(image, look)
    assert look.bright
    assert look.radius == pytest.approx(radius, rel=0.1)
    assert len(found) == 3
    places = found.centre[np.argsort(found.centre[:, 0])]
    np.testing.assert_allclose(places, CENTRES, atol=0.05)


def test_dark_circles_are_found_too():
    look = learn_appearance(255 - disc_picture(CENTRES, 7.0), 3)
    assert not look.bright
    assert len(detect(255 - disc_picture(CENTRES, 7.0), look)) == 3


def test_a_circle_cut_off_by_a_fifth_keeps_its_centre():
    look = learn_appearance(disc_picture(CENTRES, 8.0), 3)
    # 8 pixels of radius, cut 5 pixels right of the middle disc's centre
    found = detect(disc_picture(CENTRES[:2], 8.0, cut=96), look)
    nearest = np.linalg.norm(found.centre - CENTRES[1], axis=1).min()
    assert nearest < 0.15


def swinging(frames=80, seed=0):
    """A chain of 5 nodes in pixels, both ends held: 4 links of 50, in a motion that closes."""
    t = np.arange(frames) / 30
    a, b = 1.0 + 0.4 * np.sin(3 * t), 1.0 + 0.4 * np.sin(3 * t + 0.8)
    left = np.stack([50 * np.cos(a), 50 * np.sin(a)], axis=1)
    right = np.array([110.0, 0.0]) + np.stack([-50 * np.cos(b), 50 * np.sin(b)], axis=1)
    half = (right - left) / 2
    down = np.sqrt(50**2 - np.sum(half**2, axis=1))
    normal = np.stack([-half[:, 1], half[:, 0]], axis=1) / np.linalg.norm(half, axis=1)[:, None]
    middle = left + half + down[:, None] * normal
    held = np.zeros((frames, 2))
    chain = np.stack([held, left, middle, right, held + (110.0, 0.0)], axis=1)
    return chain + 0.05 * np.random.default_rng(seed).standard_normal(chain.shape) + 100


def test_the_chain_is_found_from_which_distances_stay():
    chain = swinging()
    rng = np.random.default_rng(1)
    # every frame in another order, with a reflection that stays and one that comes and goes
    frames = []
    for i, nodes in enumerate(chain):
        more = [[300.0, 20.0]] + ([[10.0 + i, 250.0]] if i % 3 == 0 else [])
        frames.append(circles(rng.permutation(np.concatenate([nodes, more]))))
    found = follow_film(frames, 5, 6.0, 30.0, Flat((400, 300)))
    np.testing.assert_allclose(found.pixels[0], chain[0], atol=1e-9)
    np.testing.assert_allclose(found.chain.length, 50.0, atol=0.3)
    # read from the right it is the same chain backwards
    backwards = follow_film(frames, 5, 6.0, 30.0, Flat((400, 300)), first="right")
    np.testing.assert_allclose(backwards.pixels[0], chain[0, ::-1], atol=1e-9)


def circles(centres):
    n = len(centres)
    return Circles(np.asarray(centres, float), np.full(n, 0.05), np.full(n, 6.0), np.ones(n), np.full(n, 100.0))


def test_nodes_keep_their_names_while_circles_come_shuffled_go_missing_and_are_made_up():
    chain = swinging(200)
    rng = np.random.default_rng(2)
    follower = Follower(Chain(chain[0], np.full(4, 50.0), np.full(4, 0.1)))
    for i, nodes in enumerate(chain[1:], start=1):
        missing = {2} if 50 <= i < 60 else ({1, 3} if 100 <= i < 105 else set())
        there = [k for k in range(5) if k not in missing]
        false = rng.uniform(0, 300, (2, 2))
        shuffled = rng.permutation(len(there) + 2)
        centres = np.concatenate([nodes[there], false])[shuffled]
        found = follower.advance(centres)
        for k in range(5):
            if k in missing:
                assert found[k] < 0 or np.linalg.norm(centres[found[k]] - nodes[k]) < 8
            else:
                assert found[k] >= 0, (i, k)
                np.testing.assert_allclose(centres[found[k]], nodes[k])
    assert (follower.lost == 0).all()


def test_a_bridged_node_stays_on_its_links():
    chain = swinging(60)
    follower = Follower(Chain(chain[0], np.full(4, 50.0), np.full(4, 0.1)))
    for i, nodes in enumerate(chain[1:], start=1):
        follower.advance(np.delete(nodes, 2, axis=0) if i >= 40 else nodes)
        if 40 <= i < 50:
            assert np.linalg.norm(follower.past[0][2] - nodes[2]) < 1.0


def test_a_look_without_markers_has_no_answer():
    assert learn_appearance(np.full((100, 100), 80, np.uint8), 3).answer == 0.0
    assert len(detect(np.full((100, 100), 80, np.uint8), MarkerAppearance(5.0, True, 50.0))) == 0


def test_frame_that_a_damaged_film_does_not_have_ends_the_film():
    """OpenCV may call such a frame good and give none."""

    class Damaged:
        grab, retrieve, release = (lambda self: True), (lambda self: (True, None)), (lambda self: None)

    video = object.__new__(Video)
    video._open = Damaged
    assert list(video.frames()) == []
