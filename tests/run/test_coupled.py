"""Coupling: steps from outside are the run with the same motion, forces balance weights, nothing fails silently."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
from scene_parts import line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError, SimulationError

DOC = Path(__file__).parents[2] / "docs" / "python.md"
ENDS = ("left", "right")
TIMES = np.linspace(0.0, 0.5, 6)
#: A loop of rope between two ends, links' masses in halves on their nodes.
LOOP = scene_of(
    {"left": [0.0, 0.0, 0.0], "right": [1.0, 0.0, 0.2]},
    line_of("loop", *ENDS, 4, 0.35, mass=0.2, nodes="shared", axial={"law": "rope", "EA": 500.0, "damping": 2.0}),
    run={"dt": 0.01, "duration": 0.5},
    start={"kind": "static"},
)


def moved():
    """The loop with ends along tables of places."""
    t = np.array([0.0, 0.0, 0.15, 0.3, 0.4, 0.4])[:, None]  # from rest to rest, so that nothing jumps
    left = np.concatenate([0.1 * np.sin(3 * t), 0.05 * t**2, 0.1 * t], axis=1)
    right = np.array([1.0, 0.0, 0.2]) + np.concatenate([-0.2 * t, 0.1 * np.sin(5 * t), 0.1 * t**2], axis=1)
    motion = {"points": list(ENDS), "time": TIMES.tolist(), "positions": [*left.tolist(), *right.tolist()]}
    return {**LOOP, "effects": {"weight": {}, "recorded_motion": motion}}


@pytest.fixture(scope="module")
def coupled():
    return dj.Coupled(LOOP, points=ENDS, accelerations=True)


def test_steps_from_outside_are_the_run_with_the_same_motion(coupled):
    """Ten steps inside each: the quintic through what is given at the rows is that of the table."""
    whole = dj.simulate(moved())
    model, _ = dj.build(moved())
    coupled.init(velocities=model.ends(0.0).velocities)
    for t in TIMES[1:]:
        ends, bends = model.ends(t), model.end_acceleration(np.asarray(t))
        force = coupled.step(ends.positions, ends.velocities, 0.1, bends)
        i = round(t / 0.01)
        assert coupled.status == "ok"
        np.testing.assert_allclose(coupled.time, t, atol=1e-12)
        np.testing.assert_allclose(coupled.positions, whole.positions[i], atol=1e-12, rtol=0)
        np.testing.assert_allclose(coupled.tension, whole.tension[i], atol=1e-12, rtol=1e-12)
        links = np.diff(whole.positions[i], axis=0)
        pull = whole.tension[i][:, None] * links / np.linalg.norm(links, axis=1)[:, None]
        half = np.array([0.0, 0.0, -0.5 * 0.2 * 9.81])
        np.testing.assert_allclose(force, [pull[0] + half, -pull[-1] + half], atol=1e-10, rtol=0)


def test_forces_at_rest_carry_the_weight(coupled):
    force = coupled.init()
    np.testing.assert_allclose(force.sum(axis=0), [0.0, 0.0, -4 * 0.2 * 9.81], atol=1e-8)
    np.testing.assert_allclose(coupled.mass, [0.1, 0.1], rtol=1e-14)
    # at other places, the same loop turned about the vertical
    turned = coupled.init([[0.0, 0.0, 0.0], [0.0, 1.0, 0.2]])
    np.testing.assert_allclose(turned[:, [1, 0, 2]], force, atol=1e-8)


def steps(coupled, number):
    still = np.zeros((2, 3))
    for _ in range(number):
        x = 0.1 * np.sin(4 * coupled.time)
        coupled.step([[x, 0, 0], [1.0, x, 0.2]], still, 0.025, still)
    return coupled.forces


@pytest.mark.parametrize("kind", ["coupled", "following"])
def test_a_restored_state_repeats_to_the_bit(kind, request, tmp_path):
    lines = request.getfixturevalue(kind)
    file = tmp_path / "saved.npz"
    lines.init()
    steps(lines, 2)
    saved, time = lines.save(file), lines.time
    after = steps(lines, 3)
    fresh = dj.Coupled(lines.scene, points=ENDS, accelerations=True)
    for other, state in ((lines, saved), (lines, file), (fresh, file)):
        other.restore(state)
        assert other.time == time
        np.testing.assert_array_equal(steps(other, 3), after)


def test_a_file_of_another_coupling_is_refused(coupled, tmp_path):
    coupled.init()
    coupled.save(tmp_path / "saved.npz")
    (tmp_path / "text.npz").write_text("none")
    heavy = dj.load_scene(LOOP).with_values({"line.0.mass": 0.3})
    for scene, name, words in (
        (heavy, "saved.npz", r"of another scene.*line\.0"),
        (FOLLOWING, "saved.npz", "steps of 0.01 s; allowed: one with accuracy 0.001"),
        (LOOP, "text.npz", "not a saved coupling"),
    ):
        with pytest.raises(SceneError, match=words):
            dj.Coupled(scene, points=ENDS, accelerations=True).restore(tmp_path / name)


def test_a_state_that_started_elsewhere_is_restored_with_the_mussels_of_its_start(tmp_path):
    """Mussels grow between 4 m and 8 m of depth only: the loop has them where it starts, not where the scene has it."""
    layer = {"depth": [4.0, 8.0], "thickness": [0.0, 0.1], "density": 1400.0}
    (line,) = LOOP["line"]
    grown = {**line, "diameter": 0.02, "growth": layer}
    water = {"sea": {"depth": 20.0}, "effects": {"weight": {}, "buoyancy": {}}}
    scene = {**LOOP, "point": [{**p, "position": [*p["position"][:2], -2.0]} for p in LOOP["point"]], **water}
    scene["line"] = [grown]
    deep = np.array([[0.0, 0.0, -7.0], [1.0, 0.0, -7.0]])
    still = np.zeros((2, 3))
    lines = dj.Coupled(scene, points=ENDS)
    lines.init(deep)
    lines.step(deep + [0.1, 0.0, 0.0], still, 0.05)
    saved = lines.save(tmp_path / "saved.npz")
    after = lines.step(deep, still, 0.05)
    started, fresh = dj.Coupled(scene, points=ENDS), dj.Coupled(scene, points=ENDS)
    started.init()
    for other, state in ((fresh, tmp_path / "saved.npz"), (started, saved)):
        other.restore(state)
        np.testing.assert_array_equal(other.mass, lines.mass)
        np.testing.assert_array_equal(other.step(deep, still, 0.05), after)


#: The loop with steps that follow an accuracy.
FOLLOWING = {**LOOP, "run": {"accuracy": 1e-3, "duration": 0.5}}


@pytest.fixture(scope="module")
def following():
    return dj.Coupled(FOLLOWING, points=ENDS, accelerations=True)


@pytest.mark.check
def test_steps_from_outside_are_divided_as_the_accuracy_of_the_scene_requires(following):
    """The run with the same motion that saves at the same times; its ends start with a jump of speed."""
    whole = dj.simulate({**moved(), "run": {**FOLLOWING["run"], "save_interval": 0.1}})
    model, _ = dj.build(moved())
    following.init(velocities=model.ends(0.0).velocities)
    for i, t in enumerate(TIMES[1:], start=1):
        ends, bends = model.ends(t), model.end_acceleration(np.asarray(t))
        following.step(ends.positions, ends.velocities, 0.1, bends)
        np.testing.assert_allclose(following.time, t, atol=1e-12)
        np.testing.assert_allclose(following.positions, whole.positions[i], atol=1e-12, rtol=0)
    assert following.status == "ok"
    assert f"accuracy: {following.unresolved} of" in " ".join(whole.warnings)


def test_a_caller_may_continue_in_its_own_arrays(coupled):
    coupled.init()
    after = steps(coupled, 3)
    coupled.init()
    place, still = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.2]]), np.zeros((2, 3))
    for _ in range(3):
        place[0, 0] = place[1, 1] = 0.1 * np.sin(4 * coupled.time)
        coupled.step(place, still, 0.025, still)
    np.testing.assert_array_equal(coupled.forces, after)


def test_a_step_that_fails_is_reported_and_leaves_the_state(coupled):
    coupled.init()
    before, still = steps(coupled, 1), np.zeros((2, 3))
    with pytest.raises(SimulationError, match=r"^(not_converged|non_finite): the step to t = 0\.05 s, 3 inner steps"):
        coupled.step([[0, 0, 0], [1e200, 0, 0]], still, 0.025, still)
    assert coupled.status in ("not_converged", "non_finite")
    assert coupled.failure.startswith(coupled.status)
    np.testing.assert_array_equal(coupled.forces, before)
    assert np.isfinite(steps(coupled, 1)).all()
    assert (coupled.status, coupled.failure) == ("ok", "")


def test_input_that_makes_no_sense_is_refused(coupled):
    coupled.init()
    places, still = [[0.0, 0, 0], [1.0, 0, 0.2]], np.zeros((2, 3))
    wrong = {
        "positions: has shape": (places[:1], still, 0.1, still),
        "positions: .*'right' is not finite": ([places[0], [1.0, np.nan, 0.0]], still, 0.1, still),
        "velocities: has shape": (places, np.zeros(3), 0.1, still),
        "dt: -1": (places, still, -1.0, still),
        "dt: 1e\\+09 s is": (places, still, 1e9, still),
        "dt: nan": (places, still, float("nan"), still),
        "accelerations: need": (places, still, 0.1),
    }
    for message, given in wrong.items():
        with pytest.raises(SceneError, match=message):
            coupled.step(*given)
    with pytest.raises(SceneError, match="not initialised"):
        dj.Coupled(LOOP, points=ENDS).step(places, still, 0.1)
    for points, message in (
        (None, "points: missing; needed"),
        (["lefd"], "did you mean 'left'"),
        (["left", "left"], "is a duplicate"),
        ([], "points: is empty"),
    ):
        with pytest.raises(SceneError, match=message):
            dj.Coupled(LOOP, points=points)
    with pytest.raises(SceneError, match="already moved by an effect"):
        dj.Coupled(moved(), points=ENDS).init()
    with pytest.raises(SceneError, match="compound links"):
        dj.Coupled("dropper-release-a-compound", points=["right"]).init()


@pytest.mark.check
def test_the_body_of_the_docs_swings_back():
    """At 5000 N/m or so and 9 t its surge has a period of some 8 s: after 4 s it is on the other side."""
    code = re.search(r"^## Couple a program .*?```python\n(.*?)```", DOC.read_text(), re.M | re.S).group(1)
    names: dict[str, object] = {}
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(code, str(DOC), "exec"), names)
    track = np.array(names["track"])
    assert "after 4 s" in out.getvalue()
    assert out.getvalue().strip().endswith("ok")
    assert np.isfinite(track).all()
    assert np.abs(track[:, 1]).max() < 1e-9  # nothing pushes it sideways
    assert np.abs(track[-20:, 2]).max() < 0.5  # heave is damped towards rest
