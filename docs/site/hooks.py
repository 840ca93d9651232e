"""What MkDocs needs to build the site: headings named as on GitHub, notebooks as pages, links out of docs/, a page of
commands and one of Python per public module, formulae, and a search that knows the words of the glossary."""

from __future__ import annotations

import base64
import json
import re
import runpy
import tomllib
from collections.abc import Iterator
from importlib.resources import files as package_files
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAGES = runpy.run_path(str(Path(__file__).with_name("pages.py")))
#: The program that typesets formulae as SVG, without fonts, within its package.
MATHJAX = "static/mathjax/es5/tex-svg.js"
#: Pages at the root of the repository, by the names that they have in the site.
ROOT_PAGES = {"CHANGELOG.md": "changes.md", "CONTRIBUTING.md": "contributing.md", "SECURITY.md": "security.md"}
#: Pages that name everything, and so match any word, count this much in the search; others count 1.
LISTS_OF_NAMES = 0.2
#: A row of a table of words: words, meaning, link to the page about them.
WORDS = re.compile(r"^\| ([^|]+) \| [^|]+ \| \[[^]]+\]\(([^)]+)\) \|$", re.M)
#: A link out of the folder of the documentation: text, target.
OUTSIDE = re.compile(r"(!?)\[([^\]]*)\]\(\.\./([^)\s]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Headings get the names that GitHub gives them, so that one link serves both."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = slug
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.copyright = f"{config.site_name} {project['version']}"
    return config


def slug(text: str, separator: str) -> str:
    """The name of a heading."""
    return re.sub(r"[^\w\- ]", "", text.lower().strip()).replace(" ", separator)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Pages and pictures from elsewhere in the repository."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    files.append(File.generated(config, "reference-commands.md", content=PAGES["commands"]()))
    for room, content in PAGES["module_pages"]().items():
        files.append(File.generated(config, f"python/{room}.md", content=content))
    files.append(File.generated(config, "mathjax.js", content=package_files("mathjax").joinpath(MATHJAX).read_bytes()))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for name, content in notebook(path):
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    wanted = {m[3] for page in ROOT.glob("docs/*.md") for m in OUTSIDE.finditer(page.read_text("utf-8")) if m[1]}
    for target in sorted(wanted):
        files.append(File.generated(config, target, content=(ROOT / target).read_bytes()))
    return files


def notebook(path: Path) -> Iterator[tuple[str, str | bytes]]:
    """Name and content of a notebook's page and of its pictures."""
    parts, number = [], 0
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                number += 1
                yield f"{path.stem}-{number}.png", base64.b64decode("".join(data["image/png"]))
                parts.append(f"![picture {number}]({path.stem}-{number}.png)")
            elif shown := "".join(output.get("text", data.get("text/plain", ""))).rstrip():
                parts.append(f"```text\n{shown}\n```")
    yield f"{path.stem}.md", "\n\n".join(parts)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links out of the folder lead to where their targets stand in the site, or are plain text."""
    if "/" in page.file.src_uri or page.file.src_uri in ROOT_PAGES.values():
        page.meta["search"] = {"boost": LISTS_OF_NAMES}
    if page.file.src_uri == "reference-python.md":
        return re.sub(r"^## (\S+)$", r"\g<0>\n\n[All of it in full](python/\1.md).", markdown, flags=re.M)
    if page.file.src_uri in ROOT_PAGES.values():
        return markdown.replace("](docs/", "](")
    return OUTSIDE.sub(_inside, markdown) if "/" not in page.file.src_uri else markdown


def _inside(found: re.Match[str]) -> str:
    sign, text, target = found.groups()
    file, mark, heading = target.partition("#")
    if file in ROOT_PAGES:
        return f"[{text}]({ROOT_PAGES[file]}{mark}{heading})"
    if target.startswith("notebooks/"):
        target = re.sub(r"\.(ipynb|py)\b", ".md", target)
    elif not sign:
        return text
    return f"{sign}[{text}]({target})"


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """The logo leads to a file, not to a folder. Pages with formulae load the program that typesets them."""
    output = re.sub(r'href="(\.\.?)" title', r'href="\1/index.html" title', output)
    if 'class="arithmatex"' not in output:
        return output
    settings = "<script>MathJax = {options: {enableMenu: false}}</script>"  # its menu would fetch more
    up = "../" * page.file.dest_uri.count("/")
    return output.replace("</body>", f'{settings}<script src="{up}mathjax.js"></script></body>')


def on_post_build(config: MkDocsConfig) -> None:
    """No page for a server's errors: the site has no server, and that page's links need one. Words for the search."""
    (Path(config.site_dir) / "404.html").unlink(missing_ok=True)
    add_words(Path(config.site_dir) / "search" / "search_index.json")


def add_words(path: Path) -> None:
    """Tags in the index of the search: each word of the glossary at the section about it."""
    index = json.loads(path.read_text(encoding="utf-8"))
    entries = {entry["location"]: entry for entry in index["docs"]}
    for words, target in WORDS.findall((ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")):
        entry = entries[target.replace("README.md", "index.md").replace(".md", ".html")]
        entry.setdefault("tags", []).extend(word.strip("` ") for word in words.split(","))
    path.write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")
