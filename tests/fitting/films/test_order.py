"""The order of the nodes and their names through a film, from circles whose places are known exactly."""

import films
import numpy as np
import pytest

from dropper_jax import SceneError
from fitting.films.flat_map import Flat
from fitting.films.following import follow_film
from fitting.films.marks import find_marks
from fitting.films.ordering import AmbiguousOrderError, paths

SIZE, RADIUS, FPS = (640, 480), 6.0, 60.0
NOISE = 0.05


@pytest.fixture(scope="module")
def places():
    """Pixels (k, n, 2) of a loop and of a chain of point masses, 3 s each."""
    named = {"loop": "loop, first circles missing", "chain": "chain, blurred"}
    return {kind: films.FILMS[name].pixels() for kind, name in named.items()}


def circles_of(pixels, seen=None, more=(), seed=0):
    """Circles of every frame in random order, those of unseen nodes missing, others of `more` (m, 2) always there."""
    rng = np.random.default_rng(seed)
    frames = []
    for i, nodes in enumerate(pixels):
        there = nodes if seen is None else nodes[seen[i]]
        centre = np.concatenate([there, np.reshape(more, (-1, 2))])
        frames.append(films.circles(rng.permutation(centre + NOISE * rng.standard_normal(centre.shape))))
    return frames


def seen_but(pixels, *hidden):
    """Which nodes are seen in which frames: all but those of pairs of frames and nodes."""
    seen = np.ones(pixels.shape[:2], bool)
    for frames, node in hidden:
        seen[frames, node] = False
    return seen


def followed(pixels, seen=None, more=(), **options):
    return follow_film(circles_of(pixels, seen, more), pixels.shape[1], RADIUS, FPS, Flat(SIZE), **options)


def check_names(found, pixels, turned=False):
    """Every circle that was taken and is not marked is the right node's; returns which were taken."""
    off = np.linalg.norm(found.pixels - (pixels[:, ::-1] if turned else pixels), axis=-1)
    marks = find_marks(found.flat, found.detected)
    assert marks.frames.mean() <= 0.02
    assert off[found.detected & ~marks.frames[:, None]].max() < 8 * NOISE
    return found.detected


@pytest.mark.parametrize("node", [1, 2, 3, 4])
def test_a_post_that_hides_a_node_of_a_loop_in_the_first_second_does_not_change_the_order(places, node):
    # the two ends rest at one distance all the time, and with a reflection there are circles enough for a chain
    pixels = places["loop"]
    seen = seen_but(pixels, (slice(70), node))
    taken = check_names(followed(pixels, seen, more=[[320.0, 460.0]]), pixels)
    assert (taken == seen).mean() > 0.99


@pytest.mark.parametrize("kind", ["loop", "chain"])
def test_any_good_second_may_settle_the_order(places, kind):
    # until 1.8 s there is always a circle missing, another one every quarter of a second
    pixels = places[kind]
    seen = seen_but(pixels, (np.arange(108), 1 + np.arange(108) // 15 % (pixels.shape[1] - 2)))
    taken = check_names(followed(pixels, seen), pixels)
    assert (taken == seen).mean() > 0.99


def test_circles_missing_in_the_first_frames_leave_only_their_own_samples_empty(places):
    pixels = places["chain"]
    seen = seen_but(pixels, (slice(6), 2), (slice(14), 4))
    assert (check_names(followed(pixels, seen), pixels) == seen).all()


def test_places_named_by_the_user_may_be_of_circles_that_are_missing_at_first(places):
    pixels = places["loop"]
    seen = seen_but(pixels, (slice(8), 2), (slice(5), 4))
    start = np.round(pixels[0][::-1])
    found = followed(pixels, seen, start=start)
    assert (check_names(found, pixels, turned=True) == seen[:, ::-1]).mean() > 0.99
    with pytest.raises(SceneError, match="near node 2"):
        followed(pixels, seen, start=np.array([*start[:2], [5.0, 5.0], *start[3:]]))


@pytest.mark.parametrize("kind", ["loop", "chain"])
def test_markers_are_taken_again_in_the_frame_in_which_they_come_back(places, kind):
    # all that moves is covered for 0.3 s, then shows again one node after the other
    pixels = places[kind]
    moving = range(1, pixels.shape[1] - (kind == "loop"))
    seen = seen_but(pixels, *((slice(70, 88 + 2 * k), k) for k in moving))
    taken = check_names(followed(pixels, seen), pixels)
    assert taken[100:].all()
    assert (taken == seen).mean() > 0.98


def test_an_unknown_order_is_refused_with_the_alternatives():
    pixels = 240.0 + films.stiff_zigzag(0.8 * np.sin(np.arange(90) / 12))
    with pytest.raises(AmbiguousOrderError, match="not known") as refused:
        followed(pixels)
    orders = refused.value.orders
    assert len(orders) == 12  # 4! orders, each of them read in two ways
    named = [np.linalg.norm(places[:, None] - pixels[refused.value.frame], axis=-1).argmin(axis=1) for places in orders]
    assert any(np.array_equal(each, way) for each in named for way in (np.arange(4), np.arange(4)[::-1]))
    # named by the user it is known
    check_names(followed(pixels, start=pixels[0]), pixels)


def test_a_stiff_row_of_markers_is_taken_along_its_line_and_that_is_reported():
    t = np.arange(60) / 10
    row = np.stack([100.0 + 60 * np.arange(4), np.full(4, 200.0)], axis=1)
    pixels = row + np.stack([30 * np.sin(t), 10 * np.cos(t)], axis=1)[:, None]
    found = followed(pixels)
    assert found.straight
    check_names(found, pixels)


def test_no_path_joins_two_resting_spots():
    # four links of a closed square, two of whose corners rest: the step between these would keep its length too
    ratio = np.full((4, 4), 50.0)
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        ratio[a, b] = ratio[b, a] = 0.1
    found = paths(ratio, np.array([True, False, False, True]), 4, 2.0)
    assert [path.tolist() for _, path in found] == [[0, 1, 2, 3]]
