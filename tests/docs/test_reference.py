"""The reference is that of the declarations, names every path of every scene, and its schema takes what is packaged."""

import re
import tomllib
from pathlib import Path

import pytest

from dropper_jax import Scene, SceneError, packaged_scene, scene_names
from dropper_jax.cli.reference import as_markdown
from dropper_jax.load.paths import locate
from dropper_jax.load.reference import find, schema, sections

ROOT = Path(__file__).parents[2]
PAGES = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"]


def test_the_page_is_that_of_the_declarations():
    made = "make it again: python -m dropper_jax.cli.reference > docs/reference.md"
    assert (ROOT / "docs" / "reference.md").read_text() == as_markdown(sections()), made


@pytest.mark.parametrize("name", ["edulis-longline", "dropper-north-sea", "paper-case-1-pitching", "platform-longline"])
def test_every_path_of_a_scene_is_described(name):
    """`--set` takes paths from its own list, made otherwise."""
    patterns = [re.escape(key.path).replace(r"\*", r"[^.]+") for section in sections() for key in section.keys]
    patterns += ["sea.(waves|current|level)", r"body\.[^.]+\.(cylinders|spheres)"]  # sections of their own
    known = re.compile("|".join(f"(?:{pattern})" for pattern in patterns))
    missing = [path for path in locate(Scene.from_dict(packaged_scene(name)).to_dict()) if not known.fullmatch(path)]
    assert [path for path in missing if ".attachments." not in path] == []


def test_every_key_has_a_meaning():
    for section in sections():
        assert section.about or not section.keys, section.path
        for key in section.keys:
            assert key.meaning.strip(), key.path
            assert key.kind, key.path


def test_a_key_is_found_by_path_by_name_and_by_section():
    assert [key.path for key in find("run.dt")[0].keys] == ["run.dt"]
    assert [key.path for key in find("line.3.mass")[0].keys] == ["line.*.mass"]
    assert "effects.linear_damping.b_l" in [key.path for section in find("b_l") for key in section.keys]
    assert find("effects.bending")[0].head == "[effects.bending]"
    with pytest.raises(SceneError, match=r"'run\.dtt' is not a key; did you mean 'run\.dt'"):
        find("run.dtt")


def test_the_command_prints_text_values_and_a_schema(printed, json_of):
    assert "run.dt: time step" in printed(["scenes", "--reference", "run.dt"]).out
    assert json_of(["scenes", "--reference", "run.dt", "--json"])["sections"][0]["keys"][0]["unit"] == "s"
    assert json_of(["scenes", "--schema"])["title"] == "A scene of dropper_jax"


def test_the_schema_takes_all_packaged_scenes_and_refuses_mistakes():
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(validator.schema)
    for name in scene_names():
        validator.validate(packaged_scene(name))
    good = packaged_scene("string")
    for wrong in (
        {"run": {**good["run"], "dt": -1.0}},
        {"run": {"dt": 1.0}},
        {"lines": []},
        {"effects": {"wind": {}}},
    ):
        assert not validator.is_valid({**good, **wrong}), wrong


def snippets(page: Path) -> list[str]:
    """Pieces of scenes on a page, fenced or indented; descriptions of measurements are no scenes."""
    text = page.read_text().partition("\n## Fit any channel\n")[0]
    indented = re.findall(r"(?:^|\n\n)((?:    \[[\[\w].*\n)(?:(?:    .*)?\n)*?)(?=\S)", text)
    return re.findall(r"^```toml\n(.*?)^```", text, re.M | re.S) + [
        re.sub("^    ", "", x, flags=re.M) for x in indented
    ]


def leaves(table: dict, before: str = "") -> list[str]:
    """Paths of all keys, `*` for entries of lists."""
    found = []
    for key, value in table.items():
        parts = value if isinstance(value, list) and value and isinstance(value[0], dict) else [value]
        for part in parts:
            path = f"{before}{key}"
            found += leaves(part, f"{path}{'.*' if part is not value else ''}.") if isinstance(part, dict) else [path]
    return found


@pytest.mark.parametrize(
    "page",
    [
        *("README", "fits", "lines-and-bodies", "longlines", "moordyn"),
        *("water", "which-number"),
    ],
)
def test_pieces_of_scenes_on_the_pages_use_keys_that_there_are(page):
    keys = {key.path for section in sections() for key in section.keys}
    known = re.compile("|".join(re.escape(key).replace(r"\*", r"[^.]+") + r"(\..+)?" for key in keys))
    read = [tomllib.loads(text) for text in snippets(ROOT / "docs" / f"{page}.md")]
    assert read or page == "moordyn"
    # tables whose keys are names of the user's own (counters, points of a unit) end a path
    unknown = [path for table in read for path in leaves(table) if not known.fullmatch(path)]
    assert [path for path in unknown if not re.match(r"unit\.[^.]+\.|body\.\*\.spheres$", path)] == []


def anchors(page: Path) -> set[str]:
    """Names of the headings of a page, as they are linked to."""
    heads = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings_that_are_there(page):
    for target in re.findall(r"\]\(([^)\s]+)[^)]*\)", page.read_text()):
        if "://" in target:
            continue
        file, _, heading = target.partition("#")
        there = page.parent / file if file else page
        assert there.exists(), f"{page.name} links to {target}"
        if heading:
            assert heading in anchors(there), f"{page.name} links to {target}"
