"""Runs in pieces: where one ends makes no difference, and a stop keeps what is done."""

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.run import chunks

ARRAYS = ("t", "positions", "velocities", "tension", "work", "kinetic")


def run(**settings):
    return dj.simulate("conical-pendulum", dt=0.01, duration=2.0, **settings)


@pytest.mark.parametrize("save_every", [1, 4])
def test_pieces_of_any_length_give_the_same_numbers(monkeypatch, save_every):
    whole = run(save_every=save_every)
    monkeypatch.setattr(chunks, "SECONDS", 0.0)
    told = []
    single = run(save_every=save_every, progress=lambda share, text: told.append(text))
    assert sum(text.startswith("t =") for text in told) == len(whole.t) - 1  # a save at a time
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(single, name), getattr(whole, name))


def test_a_long_run_shows_at_least_so_many_pieces():
    told = []
    run(progress=lambda share, text: told.append(share))
    assert len(told) > chunks.MIN_CHUNKS
    assert told == sorted(told)


def test_a_stop_keeps_what_is_done():
    def stop(share, text):
        if text.startswith("t =") and share > 0.3:
            raise KeyboardInterrupt

    found, whole = run(progress=stop), run()
    assert found.status == "interrupted"
    assert 0.3 < found.t[-1] / whole.t[-1] < 0.6
    np.testing.assert_array_equal(found.positions, whole.positions[: len(found.t)])


def test_a_piece_keeps_within_its_bytes(monkeypatch):
    model, s = dj.build("conical-pendulum")
    assert chunks._chunk_size(s) == chunks.MOST_SAVES
    monkeypatch.setattr(chunks, "CHUNK_BYTES", 1000)
    assert 1 <= chunks._chunk_size(s) < 20


def test_pieces_of_any_length_give_the_same_numbers_of_steps_that_resist(monkeypatch):
    scene = dj.load_scene("dropper-release-a").with_values({"run.dt": 0.12, "run.duration": 2.4})
    whole = dj.simulate(scene)
    monkeypatch.setattr(chunks, "SECONDS", 0.0)
    single = dj.simulate(scene)
    assert 0 < whole.retried_steps == single.retried_steps
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(single, name), getattr(whole, name))


def test_a_dropper_at_thirty_times_its_step_is_warned_of():
    run = dj.simulate("dropper-release-a", dt=0.15, duration=4.5, companion="coarser")
    assert run.status == "step_too_long"
    assert any(text.startswith("mean tension of dropper may be off by") for text in run.warnings)
