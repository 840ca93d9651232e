"""Runs in pieces: where one ends makes no difference, and a stop keeps what is done."""

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.run import chunks

ARRAYS = ("t", "positions", "velocities", "tension", "work", "kinetic")


LONG = {"dt": 0.01, "duration": 2.0}


@pytest.mark.parametrize(
    ("scene", "settings", "resists"),
    [
        ("conical-pendulum", LONG, False),
        ("conical-pendulum", {**LONG, "save_every": 4}, False),
        ("dropper-release-a", {"dt": 0.12, "duration": 2.4}, True),
    ],
)
def test_pieces_of_any_length_give_the_same_numbers(monkeypatch, scene, settings, resists):
    whole = dj.simulate(scene, **settings)
    monkeypatch.setattr(chunks, "SECONDS", 0.0)
    reported = []
    single = dj.simulate(scene, **settings, progress=lambda share, text: reported.append(text))
    assert sum(text.startswith("t =") for text in reported) == len(whole.t) - 1  # a save at a time
    assert (whole.retried_steps > 0) == resists
    assert whole.retried_steps == single.retried_steps
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(single, name), getattr(whole, name))


def test_a_long_run_shows_at_least_so_many_pieces():
    reported = []
    dj.simulate("conical-pendulum", **LONG, progress=lambda share, text: reported.append(share))
    assert len(reported) > chunks.MIN_CHUNKS
    assert reported == sorted(reported)


def test_a_piece_keeps_within_its_bytes(monkeypatch):
    scene = dj.load_scene("conical-pendulum").with_values({"run.dt": 0.01})
    _, s = dj.build(scene)
    assert chunks._chunk_size(s, scene.run) == chunks.MOST_SAVES
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 1000)
    assert 1 <= chunks._chunk_size(s, scene.run) < 20


def test_a_dropper_at_thirty_times_its_step_is_warned_of():
    run = dj.simulate("dropper-release-a", dt=0.15, duration=4.5, companion="coarser")
    assert run.status == "step_too_long"
    assert any(text.startswith("mean tension of dropper may be off by") for text in run.warnings)
