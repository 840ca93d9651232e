"""What `make check` says of its parts: none fails silently, none of the marked tests is left out."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("check_in_parts", Path(__file__).with_name("check.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look themselves up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def python(check, name, code, **environment):
    return check.Part(name, ("-c", code), environment)


def test_a_part_that_fails_is_reported_with_its_output_and_the_others_continue(check, tmp_path, capsys):
    parts = (
        python(check, "bad", "import sys; print('why it failed'); sys.exit(3)"),
        python(check, "good", "import os; print('seen', os.environ['MARK'])", MARK="here"),
    )
    assert check.main(["--out", str(tmp_path)], parts) == 1
    reported = capsys.readouterr().out
    assert "why it failed\n(whole output: " in reported
    closing = {line.split("  ")[0]: line for line in reported.splitlines()[-4:]}
    assert "FAILED: exit status 3" in closing["bad"]
    assert "ok" in closing["good"]
    assert "seen here" in closing["good"]
    assert "FAILED" in closing["all"]
    assert (tmp_path / "good.txt").read_text() == "seen here\n"


def test_a_part_that_hangs_is_a_failure(check, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(check, "MOST", 0.5)
    assert check.main(["--out", str(tmp_path)], (python(check, "stuck", "import time; time.sleep(60)"),)) == 1
    assert "FAILED: ran out of time" in capsys.readouterr().out


def test_all_good_is_exit_status_0_and_an_unknown_part_2(check, tmp_path, capsys):
    parts = (python(check, "good", "pass"),)
    assert check.main(["--out", str(tmp_path)], parts) == 0
    assert check.main(["--only", "goood"], parts) == 2
    assert "allowed: good" in capsys.readouterr().out


def test_every_folder_with_marked_tests_belongs_to_a_part(check):
    """What a part of marked tests ignores is another such part; what it leaves out by name, a part runs in full."""
    marked = [part.call[part.call.index("check") + 1 :] for part in check.PARTS if part.name.startswith("check ")]
    taken = [word for where in marked for word in where if not word.startswith("--")]
    ignored = [word.removeprefix("--ignore=") for where in marked for word in where if word.startswith("--ignore=")]
    assert sorted(taken) == sorted(["tests", *ignored])
    left_out = [word for where in marked for word in where if word.startswith("--deselect=")]
    assert left_out == [f"--deselect={check.SHORT_CASES}"]
    assert any(part.call[:3] == ("-m", "dropper_jax", "stability") for part in check.PARTS)
    named = [word for part in check.PARTS for word in part.call if word.startswith(("tests/", "benchmarks/"))]
    assert all((ROOT / word).exists() for word in named)
