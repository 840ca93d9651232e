"""The verdict on the step of several runs: the worst status, with the warnings that explain it."""

from types import SimpleNamespace

import pytest

from dropper_jax.run import step_verdict

VIBRATION = "axial vibrations are not resolved; use a shorter step"
DRIFT = "energy balance error 3 %"
CHATTER = "line 1 is slack"


@pytest.mark.parametrize("order", [("slow", "drifting", "good"), ("good", "drifting", "slow")])
def test_the_status_is_the_worst_one_and_has_its_reasons(monkeypatch, order):
    runs = {
        "slow": SimpleNamespace(status="step_too_long", warnings=(VIBRATION,)),
        "drifting": SimpleNamespace(status="energy_drift", warnings=(DRIFT,)),
        "good": SimpleNamespace(status="ok", warnings=(CHATTER,)),
    }
    monkeypatch.setattr(step_verdict, "simulate", lambda scene, **settings: runs[scene])
    verdict = step_verdict.check_steps({name: name for name in order})
    assert verdict.status == "step_too_long"
    assert sorted(verdict.warnings) == [f"drifting: {DRIFT}", f"slow: {VIBRATION}"]
