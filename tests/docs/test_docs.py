"""The documentation: its code runs, its links lead somewhere, its commands exist."""

import re
import shlex
from pathlib import Path

import jax
import pytest

from dropper_jax import Effect, register
from dropper_jax.cli import parse
from dropper_jax.effects import EFFECTS
from fitting import Camera, observe, simulate_truth, write_trace

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.glob("*.md"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)


def section(page, heading=""):
    """The text of a page, or of one of its sections."""
    text = (DOCS / page).read_text()
    if not heading:
        return text
    (found,) = re.findall(rf"^{heading}$(.*?)(?=^## |\Z)", text, re.M | re.S)
    return found


def blocks(page, language, heading=""):
    return [text for kind, text in BLOCK.findall(section(page, heading)) if kind == language]


@pytest.fixture
def registry():
    """The registry of effects as it was, whatever a page registers."""
    before = dict(EFFECTS)
    yield EFFECTS
    EFFECTS.clear()
    EFFECTS.update(before)


def run_page(page, folder, monkeypatch, heading=""):
    monkeypatch.chdir(folder)
    names = {"__name__": page}
    for text in blocks(page, "python", heading):
        exec(compile(text, page, "exec"), names)
    return names


@pytest.mark.check
@pytest.mark.slow
def test_the_section_on_effects_runs_and_keeps_what_it_promises(tmp_path, monkeypatch, registry, capsys):
    names = run_page("python.md", tmp_path, monkeypatch, "## Add an effect")
    assert registry["shock_cord"] is names["ShockCord"]
    said = capsys.readouterr().out.strip()
    assert said in section("python.md", "## Add an effect")
    model, start = names["model"], names["start"]
    force = jax.make_jaxpr(lambda r: model.effects[1].force(model.instant(r, start.v, start.t)))(start.r)
    assert "scatter" not in str(force), "a scatter keeps a run from being one kernel"
    # the promise that nothing else changes: no stepper or solver was replaced, the effect is the scene's own
    assert names["model"].effects[1].name == "shock_cord"


@pytest.mark.check
@pytest.mark.slow
def test_the_scene_and_the_code_of_the_first_page_run(tmp_path, monkeypatch):
    (tmp_path / "loop.toml").write_text(blocks("README.md", "toml")[0])
    trace = observe(simulate_truth("dropper-release-a", 2.0, 60.0, 8), Camera(rate=60.0, angle_noise=0.005), seed=0)
    write_trace(tmp_path / "traces.csv", trace)
    names = run_page("README.md", tmp_path, monkeypatch)
    assert names["solution"].status == "ok"
    assert names["result"].method == "gradient"
    assert names["result"].values == pytest.approx([0.002, 0.001], abs=0.002)


@pytest.mark.parametrize("page", ["film.md", "sweeps-and-sensitivity.md", "farms.md"])
def test_code_of_other_pages_names_what_there_is(page):
    # what they call is run by the tests of tracking and sweeps
    for text in blocks(page, "python"):
        compile(text, page, "exec")
        imports = [line for line in text.splitlines() if line.startswith(("import ", "from "))]
        assert imports
        exec("\n".join(imports), {})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: type("Nameless", (Effect,), {}), "has no `name`"),
        (lambda: type("Plain", (Effect,), {"name": "plain"}), "is not a component"),
    ],
)
def test_what_is_no_effect_cannot_be_registered(make, words, registry):
    with pytest.raises(ValueError, match=words):
        register(make())


def test_an_effect_cannot_take_the_name_of_another(registry):
    from dropper_jax import component

    other = component(type("Other", (Effect,), {"name": "weight"}))
    with pytest.raises(ValueError, match="the name .weight. is already used by dropper_jax.effects.weight.Weight"):
        register(other)
    assert register(registry["weight"]) is registry["weight"]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def commands():
    for page in PAGES:
        for kind, text in BLOCK.findall(page.read_text()):
            if kind in ("", "sh", "bash"):
                for line in text.replace("\\\n", " ").splitlines():
                    if line.startswith("dropper "):
                        yield pytest.param(line.split("  #")[0], id=f"{page.stem}: {line[:60]}")


@pytest.mark.parametrize("line", list(commands()))
def test_commands_on_the_pages_are_understood(line):
    # a misspelt option or a command that is gone ends in an error of the parser
    args = parse(shlex.split(line)[1:])
    assert callable(args.run)
