"""What MkDocs needs to build the site: headings named as on GitHub, notebooks as pages, links out of docs/."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
#: A link out of the folder of the documentation: text, target.
OUTSIDE = re.compile(r"(!?)\[([^\]]*)\]\(\.\./([^)\s]+)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Headings get the names that GitHub gives them, so that one link serves both."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = slug
    return config


def slug(text: str, separator: str) -> str:
    """The name of a heading."""
    return re.sub(r"[^\w\- ]", "", text.lower().strip()).replace(" ", separator)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Pages and pictures from elsewhere in the repository."""
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "changes.md", content=changes))
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
    return OUTSIDE.sub(_inside, markdown) if "/" not in page.file.src_uri else markdown


def _inside(found: re.Match[str]) -> str:
    sign, text, target = found.groups()
    if target.startswith("notebooks/"):
        target = re.sub(r"\.(ipynb|py)\b", ".md", target)
    elif not sign:
        return text
    return f"{sign}[{text}]({target})"
