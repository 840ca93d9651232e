"""What effects cost, and that absent ones cost nothing."""

import json

import numpy as np
import pytest
from contact_cases import sledge

from dropper_jax import build, load_scene, make_stepper
from dropper_jax.cli import main
from dropper_jax.effects import EFFECTS
from dropper_jax.study.absent_effects import Unused, program, proof, without_effects
from dropper_jax.study.cost import Variant

SCENE = "dropper-release-a"


@pytest.mark.check
def test_every_effect_adds_operations_and_the_bare_scene_has_least(tmp_path, json_of) -> None:
    found = json_of(["cost", SCENE, "--json", "--plot", str(tmp_path / "cost.png")])
    assert (found["schema"], found["status"]) == (1, "ok")
    assert (tmp_path / "cost.png").read_bytes().startswith(b"\x89PNG")
    rows = {row["name"]: row for row in found["rows"]}
    assert list(rows) == ["whole scene", *(f"without {e}" for e in load_scene(SCENE).effects), "bare scene"]
    whole = rows.pop("whole scene")
    for row in rows.values():
        assert row["flops"] < whole["flops"]
        assert row["operations"] < whole["operations"]
        assert row["us_per_step"] > 0
    assert min(rows.values(), key=lambda row: row["flops"])["name"] == "bare scene"


@pytest.mark.parametrize(
    "scene", ["dropper-release-3d", pytest.param("dropper-release-a-compound", marks=pytest.mark.check), "string"]
)
def test_absent_effects_leave_no_trace_in_the_program(scene: str) -> None:
    found = proof(load_scene(scene))
    assert found["removed_is_never_had"]
    assert found["new_effect_changes_nothing"]
    assert not found["contains_cosh"]
    assert Unused.name not in EFFECTS


def test_the_proof_can_fail() -> None:
    """Two scenes that differ by one effect have different programs, so equality says something."""
    assert program(load_scene(SCENE)) != program(load_scene(SCENE + "-undamped"))


def test_an_effect_that_needs_another_is_left_out_with_it() -> None:
    model, s = build(sledge())
    assert {"seabed", "seabed_friction"} <= {e.name for e in model.effects}
    bare = without_effects(model, ["seabed"])
    assert {"seabed", "seabed_friction"}.isdisjoint(e.name for e in bare.effects)
    make_stepper(bare, "energy_momentum")
    assert np.all(np.isfinite(bare.force(bare.instant(s.r, s.v, s.t))))


def test_corrections_of_a_step_are_counted() -> None:
    """With nothing ever good enough each step takes all corrections that it may."""
    scene = load_scene("conical-pendulum")
    model, s = build(scene)
    never = {"tolerance": 0.0, "halvings": 0}
    variant = Variant("all", model, make_stepper(model, "energy_momentum", iterations=3, **never), s, scene.run.step, 5)
    variant.times[:] = [5 * 30e-6]
    variant.count_corrections()
    row = variant.row(variant)
    assert row["corrections_per_step"] == 3.0
    assert row["us_per_correction"] == pytest.approx(10.0)


def test_an_interrupted_cost_keeps_the_rows_that_were_printed(monkeypatch, capsys) -> None:
    def stop(self: Variant) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Variant, "count_corrections", stop)
    assert main(["cost", "conical-pendulum", "--json"]) == 130
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["status"] == "interrupted"
    assert [row["name"] for row in found["rows"]] == ["whole scene", "without weight", "bare scene"]
    assert all(row["us_per_step"] > 0.0 and row["corrections_per_step"] is None for row in found["rows"])
    assert [line.split("  ")[0] for line in printed.err.splitlines()[1:4]] == [row["name"] for row in found["rows"]]
