"""Parts of tracking on their own: angles, circles, the order of the chain, identity."""

import films
import numpy as np
import pytest

from fitting.films.detection import MarkerAppearance, detect, learn_appearance
from fitting.films.flat_map import Flat
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
    nodes = np.array([0.2, 0.3]) + 0.15 * np.array([[0.0, 0.0], [np.cos(direction), np.sin(direction)]])
    expected = thesis_angle(*(nodes * [-1.0, 1.0] + [5.0, 0.0]).ravel())  # x to the left in a picture 5 m wide
    assert four_quadrant(nodes[None])[0, 0] == pytest.approx(expected)


def test_a_link_that_turns_twice_has_a_continuous_angle():
    turn = np.linspace(0.3, 0.3 + 4 * np.pi, 200)
    places = np.stack([np.zeros((200, 2)), np.stack([np.cos(turn), np.sin(turn)], axis=1)], axis=1)
    np.testing.assert_allclose(four_quadrant(places)[:, 0], turn, atol=1e-12)


def test_the_error_of_an_angle_is_that_of_random_places():
    link = np.array([[[0.0, 0.0], [60.0, 80.0]]])
    places = link + 0.3 * np.random.default_rng(0).standard_normal((4000, 2, 2))
    assert angle_errors(link, np.full((1, 2), 0.3))[0, 0] == pytest.approx(np.std(four_quadrant(places)), rel=0.05)


def disc_picture(centres, radius):
    return next(films.discs([centres], radius, (200, 150)))


CENTRES = np.array([[40.3, 40.7], [90.55, 80.2], [150.1, 60.9]])


@pytest.mark.parametrize("radius", [4.0, 8.0, 16.0])
def test_circles_of_any_size_are_found_to_a_twentieth_of_a_pixel(radius):
    for bright, image in ((True, disc_picture(CENTRES, radius)), (False, 255 - disc_picture(CENTRES, radius))):
        look = learn_appearance(image, 3)
        found = detect(image, look)
        assert look.bright == bright
        assert look.radius == pytest.approx(radius, rel=0.1)
        np.testing.assert_allclose(found.centre[np.argsort(found.centre[:, 0])], CENTRES, atol=0.05)


def test_a_circle_cut_off_by_a_fifth_keeps_its_centre():
    look = learn_appearance(disc_picture(CENTRES, 8.0), 3)
    image = disc_picture(CENTRES, 8.0)
    image[:, 96:] = 60  # 8 pixels of radius, cut 5 pixels right of the middle disc's centre
    assert np.linalg.norm(detect(image, look).centre - CENTRES[1], axis=1).min() < 0.15


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
        more = [[300.0, 20.0], [10.0 + i, 250.0]][: 1 + (i % 3 == 0)]
        frames.append(films.circles(rng.permutation(np.concatenate([nodes, more]))))
    found = follow_film(frames, 5, 6.0, 30.0, Flat((400, 300)))
    np.testing.assert_allclose(found.pixels[0], chain[0], atol=1e-9)
    np.testing.assert_allclose(found.chain.length, 50.0, atol=0.3)
    # read from the right it is the same chain backwards
    backwards = follow_film(frames, 5, 6.0, 30.0, Flat((400, 300)), first="right")
    np.testing.assert_allclose(backwards.pixels[0], chain[0, ::-1], atol=1e-9)


def test_nodes_keep_their_names_while_circles_come_shuffled_go_missing_and_are_made_up():
    chain = swinging(200)
    rng = np.random.default_rng(2)
    follower = Follower(Chain(chain[0], np.full(4, 50.0), np.full(4, 0.1)))
    for i, nodes in enumerate(chain[1:], start=1):
        missing = [2] * (50 <= i < 60) + [1, 3] * (100 <= i < 105)
        centres = rng.permutation(np.concatenate([np.delete(nodes, missing, axis=0), rng.uniform(0, 300, (2, 2))]))
        found = follower.advance(centres)
        off = np.where(found < 0, np.nan, np.linalg.norm(centres[found] - nodes, axis=1))
        assert not np.any(off[missing] >= 8)
        np.testing.assert_allclose(np.delete(off, missing), 0.0, atol=1e-12, err_msg=f"{i}")
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
