"""Generated pages are those of the code, and the site holds together: links, headings, nothing fetched."""

import importlib.util
import inspect
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote

import pytest

import dropper_jax as dj
import fitting
from dropper_jax import INTEGRATORS
from dropper_jax.base.markdown import prose
from dropper_jax.cli import find_commands
from dropper_jax.effects import EFFECTS

#: The site takes 15 s to build, and no change of the packages breaks it unless a page or a docstring changes.
pytestmark = pytest.mark.check

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("pages", ROOT / "docs" / "site" / "pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages(generator):
    return generator.pages()


@pytest.mark.parametrize(
    "name", ["physics.md", "../CONTRIBUTING.md", "reference.md", "reference-effects.md", "reference-python.md"]
)
def test_the_stored_page_is_that_of_the_code(name, pages):
    assert (ROOT / "docs" / name).read_text() == pages[name], "make it again: python docs/site/pages.py"


def test_everything_public_is_on_its_page(pages, generator):
    effects, python = (pages[f"reference-{part}.md"] for part in ("effects", "python"))
    commands = generator.commands()
    assert [e.name for e in find_commands() if f"\n## dropper {e.name}\n" not in commands] == []
    assert [name for name in EFFECTS if f"\n### effects.{name}\n" not in effects] == []
    assert [name for name in INTEGRATORS if f"\n### {name}\n" not in effects] == []
    for package in (dj, fitting):
        headings = re.findall(rf"^### (?:class )?{package.__name__}\.(\w+)$", python, re.M)
        assert sorted(headings) == sorted(package.__all__)


def test_everything_public_is_described(generator):
    for package in (dj, fitting):
        for name in package.__all__:
            if name != "INTEGRATORS":
                assert generator._described(getattr(package, name)).strip(), name
                assert (getattr(package, name).__doc__ or "").strip(), name


def test_prose_keeps_code_and_shows_the_rest_unchanged():
    assert prose("`a*b` and a*b") == r"`a*b` and a\*b"
    assert prose("`|z| <= 1` in <x>", in_table=True) == "<code>&#124;z&#124; &lt;= 1</code> in &lt;x&gt;"
    assert prose("`|z|`") == "`|z|`"
    assert prose("a ` alone") == r"a \` alone"


class Parts(HTMLParser):
    """Names, links and fetched things of a page."""

    def __init__(self):
        super().__init__()
        self.ids, self.links, self.fetched = set(), [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        self.fetched += [values[key] for key in ("src", "srcset", "data") if key in values]
        if tag == "link" and values["rel"] != "prev" and values["rel"] != "next":
            self.fetched.append(values["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    # as `make docs`; with --quiet it would not count warnings
    call = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_builds_and_no_internal_link_is_broken(site):
    pages = {path: Parts() for path in sorted(site.rglob("*.html"))}
    for path, parts in pages.items():
        parts.feed(path.read_text(encoding="utf-8"))
    assert len(pages) >= 30
    for path, parts in pages.items():
        assert len(parts.links) > 20
        for target in parts.links + parts.fetched:
            if re.match(r"[a-z]+:", target):
                continue
            file, _, heading = unquote(target).partition("#")
            there = (path.parent / file).resolve() if file else path
            assert there.is_file(), f"{path.name}: {target}"
            if heading:
                assert heading in pages[there].ids, f"{path.name}: {target}"


def test_the_site_fetches_nothing_from_elsewhere(site):
    for path in site.rglob("*.html"):
        parts = Parts()
        parts.feed(path.read_text(encoding="utf-8"))
        assert [target for target in parts.fetched if re.match(r"([a-z]+:)?//", target)] == []
    for path in site.rglob("*.css"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"@font-face|@import", text), path.name
        assert [
            target for target in re.findall(r"url\(([^)]*)\)", text) if not target.strip("'\"").startswith("data:")
        ] == []
    assert [p.name for p in site.rglob("*") if p.suffix in (".woff", ".woff2", ".ttf", ".otf", ".eot")] == []


def test_every_formula_is_typeset_by_a_program_of_the_site(site):
    count = 0
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        count += text.count('class="arithmatex"')
        assert ('class="arithmatex"' in text) == ("mathjax.js" in text), path.name
    assert count >= 10
    assert (site / "mathjax.js").stat().st_size > 1e6


def test_every_public_module_has_a_page_with_all_its_names(site, generator):
    for room in generator.ROOMS:
        page = (site / "python" / f"{room}.html").read_text(encoding="utf-8")
        headings = re.findall(r'<h2 id="[^"]*" class="doc[^>]*>\s*(?:<[^>]*>)?([\w]+)|<h2 id="(\w+)"', page)
        assert {one or other for one, other in headings} >= {
            name if inspect.isclass(thing) or callable(thing) else name.lower()
            for name in generator._names(room)
            for thing in [getattr(import_module(room), name)]
        }, room


def test_the_index_of_the_search_has_every_page(site):
    text = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    entries = json.loads(text.partition("=")[2])["docs"]
    found = {entry["location"].partition("#")[0] for entry in entries}
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    assert pages <= found
    assert "accuracy.html#snap-loads" in {entry["location"] for entry in entries if "Snap loads" in entry["title"]}


def test_every_word_of_the_glossary_leads_the_search_to_the_section_about_it(site):
    text = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    tags = {entry["location"]: entry.get("tags", []) for entry in json.loads(text.partition("=")[2])["docs"]}
    assert "anchor" in tags["which-number.html#fixed-points-and-anchors"]
    glossary = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*) \| .* \|$", glossary.partition("| word | meaning | page |")[2], re.M)
    words = [word.strip("` ") for row in rows if "---" not in row for word in row.split(" | ")[0].split(",")]
    tagged = {tag for found in tags.values() for tag in found}
    assert [word for word in words if word not in tagged | {"word"}] == []


#: What a user types, and the section or page that answers.
ANSWERS = {
    "tension": "which-number.html#tension-utilisation-parts",
    "anchor": "which-number.html#fixed-points-and-anchors",
    "position": "index.html#positions-and-tensions-of-a-run",
    "current": "water.html#define-a-current",
    "added mass": "water.html#choose-forces",
    "growth": "water.html#growth-of-mussels",
    "snap": "accuracy.html#snap-loads",
    "snap load": "accuracy.html#snap-loads",
    "damping ratio": "longlines.html#natural-periods-and-damping-ratios",
    "gradient": "index.html#gradients-and-batches",
    "batch": "sweeps-and-sensitivity.html#run-many-cases-in-batches",
    "MoorDyn": "moordyn.html",
    "uncertainty": "fits.html#noise-and-errors",
}
#: Types one word after the other; `hits` has the links of the first result of each, its page first.
TYPES = """<script>const hits = {}, words = WORDS;
const type = () => {
  const input = document.querySelector("[data-md-component=search-query]"), word = words[0];
  const list = document.querySelector(".md-search-result__list");
  const links = [...list.querySelectorAll("li:first-child a.md-search-result__link")];
  if (input.value !== word) {
    list.replaceChildren(); input.focus(); input.value = word;
    for (const event of ["keyup", "input"]) input.dispatchEvent(new Event(event, { bubbles: true }));
  } else if (links.length) {
    hits[word] = links.map((link) => link.getAttribute("href").split("/").pop().replace(/[?]h=[^#]*/, ""));
    words.shift();
  }
  if (words.length) setTimeout(type, 100);
};
setTimeout(type, 100);</script></body>"""


@pytest.mark.slow
def test_the_first_hit_of_the_search_answers_in_a_browser_without_a_server(site, in_browser):
    page = (site / "index.html").read_text(encoding="utf-8")
    file = site / "looked-at.html"
    typing = TYPES.replace("WORDS", json.dumps(list(ANSWERS)))
    hits = in_browser(page.replace("</body>", typing), "hits", every=500, after=60000, file=file)
    file.unlink()
    # the first link of a result is that of its page, the second that of the section which fits best
    assert {word: links[: 1 + ("#" in ANSWERS[word])][-1] for word, links in hits.items()} == ANSWERS


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_formulas_are_readable_in_a_browser_on_a_phone(site, in_browser, width):
    probe = """[innerWidth, document.documentElement.scrollWidth, ...[...document.querySelectorAll(".arithmatex")].map(
      (box) => { const svg = box.querySelector("svg"), size = svg.getBoundingClientRect();
        return [size.width, size.height, box.clientWidth, svg.viewBox.baseVal.width, svg.viewBox.baseVal.height]; })]"""
    count = 0
    for name in ("physics", "water"):
        file = site / f"{name}-looked-at.html"
        page = (site / f"{name}.html").read_text(encoding="utf-8")
        screen, content, *formulas = in_browser(page, probe, every=500, after=2000, width=width, file=file)
        file.unlink()
        assert screen == width
        assert content <= screen  # the page does not scroll sideways
        for across, high, room, units, units_high in formulas:
            assert across / units == pytest.approx(high / units_high, rel=0.05)
            assert 1000 * across / units >= 14.0  # px of the letter's body
            assert across <= room  # whole, not to be scrolled
            count += 1
    assert count >= 12


def test_every_page_of_the_documentation_is_in_the_site(site):
    for page in (ROOT / "docs").glob("*.md"):
        name = "index.html" if page.stem == "README" else f"{page.stem}.html"
        assert (site / name).is_file(), name
