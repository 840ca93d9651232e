"""What a notebook shows of a scene and a run, and the log of the library."""

import logging
import subprocess
import sys

import dropper_jax as dj


def test_a_scene_and_a_run_are_small_tables_that_escape_what_a_user_wrote():
    solution = dj.simulate("conical-pendulum", duration=0.1)
    scene, run = solution.scene._repr_html_(), solution._repr_html_()
    assert "<caption>Scene conical-pendulum: 1 lines" in scene
    assert "1 links, 1 m, 1 kg" in scene
    assert "0 to 0.1 s, 6 saved times" in run
    assert max(len(scene), len(run)) < 2000
    assert "<b>" not in solution.scene.with_values({"name": "<b>"})._repr_html_()


def test_a_run_is_logged_and_nothing_is_printed_without_a_handler(caplog):
    with caplog.at_level(logging.INFO, "dropper_jax"):
        dj.simulate("conical-pendulum", duration=0.1)
    assert [record.name for record in caplog.records] == ["dropper_jax"]
    assert caplog.records[0].getMessage().startswith("conical-pendulum: ok at 0.1 s")
    code = "import dropper_jax as dj; from dropper_jax.run.simulate import LOG; LOG.warning('x')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""
