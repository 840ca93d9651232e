"""Decks of MoorDyn's, OpenFAST's and MoorPy's kinds: at rest their tensions are MoorDyn's or MoorPy's within 1 %.

Convention: MoorDyn's tension at an inner node is the size of the mean of the two links' pulls, at an end that of the
last link.
MoorPy's is that at the very end of the line: of the last link with the end's half of its weight, and without that
where the end lies on the bed. Numbers of both stand in `decks/rest.json` (`others.py`: MoorDyn 2.7.2, MoorPy 1.3.0).
"""

import importlib.util
import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import equilibrium, load_scene, read_moordyn
from dropper_jax.decks.reading.reader import line_parts
from dropper_jax.decks.reading.sections import read_input, split_file
from dropper_jax.load.surface import bed_height

OTHERS = runpy.run_path(str(Path(__file__).with_name("others.py")))
DECKS, DEPTH, WHEEL, MOORPY, by_itself = (OTHERS[key] for key in ("DECKS", "DEPTH", "WHEEL", "MOORPY", "by_itself"))
REST = json.loads((DECKS / "rest.json").read_text())
#: Beside 1 % of a tension: a part of the deck's largest, for ends that carry next to nothing.
LEAST = 1e-3
#: What is solved in every run of the tests, a deck of each shape; the others have the programs of these, or wait.
QUICK = ("catenary.txt", "file_ic.txt", "no_depth.txt", "openfast_v1.dat", "slack_on_the_bed.txt", "viscoelastic.txt")
QUICK += ("clump_and_buoy.txt", "joined_by_rods.txt", "moorpy_catenary.yaml")


def scene_of(name):
    return load_scene(read_moordyn(DECKS / name, DEPTH) if name == "no_depth.txt" else DECKS / name)


def tensions(name):
    """Tensions of every line's links, at rest, and the nodes of the line."""
    scene = scene_of(name)
    pose = equilibrium(scene)
    assert pose.status == "ok"
    found, link, node = [], 0, 0
    for line in scene.lines:
        nodes = pose.positions[node : node + line.links + 1]
        found.append((line, pose.tension[link : link + line.links], nodes))
        link, node = link + line.links, node + line.links + 1
    return scene, found


def very_end(scene, line, tension, nodes, end):
    """Tension at an end of a line, with the end's half of the last link's weight where the bed does not carry it."""
    here, inner = (nodes[0], nodes[1]) if end == 0 else (nodes[-1], nodes[-2])
    pull = tension[end] * (inner - here) / np.linalg.norm(inner - here)
    bed = bed_height(scene, here)
    on_bed = bed is not None and inner[2] < bed_height(scene, inner) + 0.5 * line.diameter[end]
    wet = line.mass[end] - scene.sea.density * np.pi / 4 * line.diameter[end] ** 2 * line.length[end]
    return np.linalg.norm(pull - [0.0, 0.0, 0.0 if on_bed else 0.5 * 9.81 * wet])


def each(names):
    return [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.check]) for n in names]


def lines_of_the_deck(name):
    """Tensions and nodes of every line of the deck, from its end A, also of those that are one line of the scene."""
    found = {line.name: (ours, nodes) for line, ours, nodes in tensions(name)[1]}
    path = DECKS / name
    for part in line_parts(split_file(path, read_input(path))).values():
        ours, nodes = found[part.line]
        links = slice(part.first, part.first + part.links)
        step = -1 if part.turned else 1
        yield ours[links][::step], nodes[links.start : links.stop + 1][::step]


@pytest.mark.check
@pytest.mark.parametrize("name", each(WHEEL))
def test_tensions_at_rest_are_those_of_moordyn(name):
    for (ours, places), theirs in zip(lines_of_the_deck(name), REST[name], strict=True):
        links = np.diff(places, axis=0)
        pulls = ours[:, None] * links / np.linalg.norm(links, axis=1, keepdims=True)
        inner = 0.5 * np.linalg.norm(pulls[1:] + pulls[:-1], axis=1)
        nodes = np.concatenate([ours[:1], inner, ours[-1:]])
        np.testing.assert_allclose(nodes, theirs, rtol=0.01, atol=LEAST * max(max(line) for line in REST[name]))


@pytest.mark.check
def test_a_cable_in_a_lazy_wave_rests_as_in_cabledyn():
    """Finite elements, twelve for each of the links here (`of_cabledyn.py`)."""
    theirs = json.loads((DECKS / "lazy_wave_cable_cabledyn.json").read_text())
    ((line, ours, nodes),) = tensions("lazy_wave_cable.txt")[1]
    np.testing.assert_allclose(ours, theirs["tensions"], rtol=1e-3)
    np.testing.assert_allclose(nodes, theirs["positions"], atol=2e-4 * line.length.sum())


@pytest.mark.parametrize("name", each(MOORPY))
def test_tensions_at_rest_are_those_of_moorpy(name):
    scene, found = tensions(name)
    for (line, ours, nodes), theirs in zip(found, REST[name], strict=True):
        ends = [very_end(scene, line, ours, nodes, end) for end in (0, -1)]
        np.testing.assert_allclose(ends, theirs, rtol=0.01)


@pytest.mark.check
@pytest.mark.parametrize("name", [*WHEEL, *MOORPY])
def test_the_stored_tensions_are_what_the_others_give(name):
    module = "moordyn" if name in WHEEL else "moorpy"
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    for now, stored in zip(by_itself(name), REST[name], strict=True):
        np.testing.assert_allclose(now, stored, rtol=2e-3, atol=LEAST * max(stored))
