"""Write the generated pages of the documentation: python docs/site/pages.py

| page | from |
| --- | --- |
| reference.md | declarations of the keys of a scene (`python -m dropper_jax.cli.reference`) |
| reference-effects.md | docstrings of effects, schemes, linear solvers and axial laws |
| reference-python.md | public names of `dropper_jax`, `fitting` and their modules, with the first words of docstrings |
| physics.md | the source of the step, in its place on a page written by hand |
| ../CONTRIBUTING.md | the folders of both packages, by their layers in pyproject.toml and their docstrings, likewise |

A test holds the stored pages to them. Two more kinds are made when the site is built: the commands, from their parsers
(`commands`), and a page for each public module (`module_pages`).
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path

from dropper_jax.axial import LAWS
from dropper_jax.base.markdown import prose
from dropper_jax.cli import _load, _Parser, command_groups
from dropper_jax.cli.reference import as_markdown
from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.load.reference import sections
from dropper_jax.solvers import SOLVERS

FOLDER = Path(__file__).parents[1]
MADE = "Made by `python docs/site/pages.py`; a test holds the page to {what}."
#: Rooms whose names are public beside those of the two packages.
ROOMS = (
    "dropper_jax",
    "dropper_jax.plots",
    "dropper_jax.statics",
    "dropper_jax.report.page",
    "dropper_jax.analysis",
    "fitting",
    "fitting.sweep",
    "fitting.sensitivity",
    "fitting.films",
    "fitting.farm.cases",
    "fitting.farm.season",
    "fitting.farm.site",
)
#: A place for source code on a page: its module and the names of its functions.
SOURCE = re.compile(r"(<!-- source: ([\w.]+): ([\w, ]+) -->\n).*?(<!-- end source -->)", re.DOTALL)
#: A place for the folders of a package on a page.
FOLDERS = re.compile(r"(<!-- folders: (\w+) -->\n).*?(<!-- end folders -->)", re.DOTALL)
#: Heads of the parts of a docstring that list names.
LISTS = ("Args", "Attributes", "Returns", "Raises", "Yields")


def docstring(text: str | None) -> str:
    """A docstring as Markdown: paragraphs, equations and examples as they are, lists of names as lists."""
    if not text:
        return ""
    parts, lines = [], inspect.cleandoc(text).splitlines()
    while lines:
        if not lines[0].strip():
            lines.pop(0)
        elif lines[0].rstrip(":") in LISTS and lines[0].endswith(":"):
            head, block = lines.pop(0), list(_taken(lines, lambda line: line.startswith(" ") or not line.strip()))
            parts.append(f"{head}\n\n{_listed(block)}")
        elif lines[0].startswith(" "):
            block = list(_taken(lines, lambda line: line.startswith(" ") or not line.strip()))
            parts.append("```text\n" + "\n".join(inspect.cleandoc("\n".join(["", *block])).splitlines()) + "\n```")
        elif lines[0].startswith("|"):
            parts.append("\n".join(_taken(lines, lambda line: line.startswith("|"))))
        else:
            block = list(_taken(lines, lambda line: line.strip() and not line.startswith((" ", "|"))))
            parts.append(_paragraph(block))
    return "\n\n".join(parts)


def _taken(lines: list[str], fits) -> Iterator[str]:
    while lines and fits(lines[0]):
        yield lines.pop(0)


def _paragraph(block: list[str]) -> str:
    if not any(line.startswith("- ") for line in block):
        return prose(" ".join(block))
    items, text = [], []
    for line in block:
        if line.startswith("- "):
            items.append([line[2:]])
        else:
            (items[-1] if items else text).append(line)
    return "\n\n".join(
        part for part in (prose(" ".join(text)), "\n".join(f"- {prose(' '.join(item))}" for item in items)) if part
    )


def _listed(block: list[str]) -> str:
    """`name: what it is`, deeper lines going on with the one before."""
    items: list[list[str]] = []
    for line in inspect.cleandoc("\n".join(["", *block])).splitlines():
        if line.strip() and (not line.startswith(" ") or not items):
            items.append([line.strip()])
        elif line.strip():
            items[-1].append(line.strip())
    return "\n".join(f"- {_named(' '.join(item))}" for item in items)


def _named(text: str) -> str:
    match = re.match(r"^([\w., *]+?): (.*)$", text)
    return f"`{match[1]}`: {prose(match[2])}" if match else prose(text)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = list(head)
    lines = [f"| {' | '.join(head)} |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _range(one: Mapping[str, object]) -> str:
    ends = {"from": one["low"], "above": one["above"], "to": one["high"]}
    return " ".join(f"{word} {value:g}" for word, value in ends.items() if value is not None)


def effects() -> str:
    """What acts, and how it is stepped and solved."""
    made = MADE.format(what="the docstrings")
    parts = [
        f"# Effects and schemes\n\n{made} Keys, units and ranges of the effects are in [every key of a "
        "scene](reference.md), derivations in [the physics](physics.md), how to add one in [Python and own effects]"
        "(python.md#add-an-effect).",
        "## Effects\n\n`[effects.NAME]` in a scene; what is not named is not computed.",
    ]
    for name, cls in EFFECTS.items():
        parts += [f"### effects.{name}", docstring(cls.__doc__)]
        keys = [key for section in sections() if section.path == f"effects.{name}" for key in section.keys]
        if keys:
            parts.append("Keys: " + ", ".join(f"`{key.name}`" for key in keys) + ".")
    parts.append("## Integrators\n\n`integrator` of `[run]`, `--integrator`; which to take: [accuracy](accuracy.md).")
    for name, cls in INTEGRATORS.items():
        parts += [f"### {name}", docstring(_module(cls)), docstring(cls.__doc__)]
        if options := cls.options():
            rows = ((f"`{key}`", prose(one["meaning"], True), _range(one)) for key, one in options.items())
            parts.append(_table(("option", "meaning", "allowed"), rows))
    parts.append("## Axial laws\n\n`kind` of `[line.axial]`: how the length of a link and its tension belong together.")
    for name, cls in LAWS.items():
        parts += [f"### axial: {name}", docstring(_module(cls)), docstring(cls.__doc__)]
    parts.append("## Linear solvers\n\n`solver` of `[run]`, `--solver`; `auto` takes the one that fits.")
    for name, solver in SOLVERS.items():
        parts += [f"### solver: {name}", docstring(_module(type(solver))), docstring(type(solver).__doc__)]
    return _page(parts)


def _module(cls: type) -> str | None:
    return inspect.getdoc(sys.modules[cls.__module__])


def commands() -> str:
    """What `dropper` does."""
    groups = {group: {e.name: _load(e) for e in entries} for group, entries in command_groups().items()}
    loaded = {name: command for own in groups.values() for name, command in own.items()}
    parts = [
        "# Commands\n\n`dropper COMMAND --help` prints the same. Exit codes: 0 good, 2 invalid input, 3 a run "
        "that failed, 130 one that was interrupted.",
    ]
    for group, own in groups.items():
        rows = ((f"[`{name}`](#dropper-{name})", prose(c.help, True)) for name, c in own.items())
        parts += [f"**{group}**", _table(("command", "does"), rows)]
    for name, command in loaded.items():
        parser = _Parser(prog=f"dropper {name}")
        command.add_arguments(parser)
        hidden = argparse.SUPPRESS
        actions = [a for a in parser._actions if not isinstance(a, argparse._HelpAction) and a.help is not hidden]
        parts += [f"## dropper {name}", prose(_sentence(command.help)), f"```text\n{_usage(name, actions)}\n```"]
        rows = [(_option(action), _meaning(action, parser), _default(action)) for action in actions]
        if parser.epilog:
            examples = "\n".join(line.strip() for line in parser.epilog.splitlines()[1:])
            parts.append(f"```text\n{examples}\n```")
        if rows:
            parts.append(_table(("argument", "meaning", "default"), rows))
    return _page(parts)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _usage(name: str, actions: list[argparse.Action]) -> str:
    words = [f"dropper {name}"]
    for action in actions:
        if not action.option_strings:
            word = action.metavar or action.dest
            words.append({"?": f"[{word}]", "*": f"[{word} ...]", "+": f"{word} [...]"}.get(action.nargs, word))
    return " ".join([*words, "[options]"])


def _value(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    if isinstance(action.metavar, tuple):
        return " ".join(action.metavar)
    word = action.metavar or ("{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper())
    return f"{word} ..." if action.nargs in ("+", "*") else word


def _option(action: argparse.Action) -> str:
    if not action.option_strings:
        return f"`{action.metavar or action.dest}`"
    return f"`{', '.join(action.option_strings)} {_value(action)}".strip() + "`"


def _meaning(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    text = "" if action.help is None else action.help % {**vars(action), "prog": parser.prog}
    if action.choices and str(next(iter(action.choices))) not in text:
        text += f" (one of {', '.join(map(str, action.choices))})"
    return prose(text, True)


def _default(action: argparse.Action) -> str:
    if action.default in (None, False, [], argparse.SUPPRESS) or not action.option_strings:
        return ""
    return f"`{action.default}`"


def python() -> str:
    """What can be imported."""
    made = MADE.format(what="the docstrings")
    parts = [
        f"# Python\n\n{made} All public names, in one sentence each. The site has a page per module with arguments, "
        "shapes, units and errors; `help(NAME)` prints the same."
    ]
    parts.append(
        _table(
            ("from", "names"),
            ((f"`{room}`", ", ".join(f"[`{n}`](#{_anchor(room, n)})" for n in _names(room))) for room in ROOMS),
        )
    )
    for room in ROOMS:
        parts += [f"## {room}", docstring(import_module(room).__doc__)]
        for name in _names(room):
            parts += [f"### {_heading(room, name)}", _described(getattr(import_module(room), name))]
    return _page(parts)


def module_pages() -> dict[str, str]:
    """A page for each public module; mkdocstrings replaces `::: path` by the description of what is defined there."""
    return {room: _page([f"# {room}", docstring(import_module(room).__doc__), *_members_of(room)]) for room in ROOMS}


def _members_of(room: str) -> Iterator[str]:
    for name in _names(room):
        thing = getattr(import_module(room), name)
        if inspect.isclass(thing) or callable(thing):
            yield f"::: {thing.__module__}.{thing.__qualname__}"
        else:
            yield f"## {name}\n\n{_described(thing)}"


def _names(room: str) -> list[str]:
    return sorted(import_module(room).__all__, key=lambda name: (name.isupper(), name.lower()))


def _heading(room: str, name: str) -> str:
    """`class` in front tells `State` and `state` apart where links have no capitals."""
    return f"{'class ' * inspect.isclass(getattr(import_module(room), name))}{room}.{name}"


def _anchor(room: str, name: str) -> str:
    return _heading(room, name).replace(".", "").replace(" ", "-").lower()


def _described(thing: object) -> str:
    """The names or values of a constant, else the first paragraph of the docstring."""
    if isinstance(thing, Mapping):
        return "Names: " + ", ".join(f"`{key}`" for key in thing) + "."
    if isinstance(thing, tuple):
        return "Values: " + ", ".join(f"`{one}`" for one in thing) + "."
    return docstring((inspect.getdoc(thing) or "").split("\n\n")[0])


def with_sources(text: str) -> str:
    """A page with the present source at each of its places for it."""
    return SOURCE.sub(lambda place: f"{place[1]}\n{_code(place[2], place[3].split(', '))}\n\n{place[4]}", text)


def with_folders(text: str) -> str:
    """A page with the present folders at each of its places for them."""
    return FOLDERS.sub(lambda place: f"{place[1]}\n{_folders(place[2])}\n\n{place[3]}", text)


def _folders(package: str) -> str:
    """Folders from the uppermost layer down, with the first sentences of their docstrings."""
    root = FOLDER.parent
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (layers,) = [contract["layers"] for contract in contracts if contract.get("containers") == [package]]
    rows = {}
    for name in " | ".join(layers).split(" | "):
        folder = name.partition(".")[0]
        file = root / package / folder / "__init__.py"
        if file.is_file():
            about = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
            sentence = re.match(r".*?\.(?=\s|$)", " ".join(about.split()))[0]
            rows[folder] = (f"`{package}.{folder}`", prose(sentence.removesuffix("."), True))
    return _table(("folder", "subject"), rows.values())


def _code(module: str, names: list[str]) -> str:
    """The source of functions of a module, as a block of a page."""
    source = inspect.getsource(import_module(module))
    lines = source.splitlines()
    functions = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    parts = []
    for name in names:
        node = functions[name]
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        parts.append("\n".join(lines[first - 1 : node.end_lineno]))
    # no command of the pages: tests run those that are marked as Python
    return "\n".join(["```py", "\n\n\n".join(parts), "```"])


def _page(parts: Iterable[str]) -> str:
    return "\n\n".join(part.strip() for part in parts if part and part.strip()) + "\n"


def pages() -> dict[str, str]:
    """Names and texts of the stored pages."""
    return {
        "reference.md": as_markdown(sections()),
        "reference-effects.md": effects(),
        "reference-python.md": python(),
        "physics.md": with_sources((FOLDER / "physics.md").read_text(encoding="utf-8")),
        "../CONTRIBUTING.md": with_folders((FOLDER.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")),
    }


if __name__ == "__main__":
    for file, text in pages().items():
        (FOLDER / file).write_text(text, encoding="utf-8")
        print(f"docs/{file}: {len(text.splitlines())} lines")
