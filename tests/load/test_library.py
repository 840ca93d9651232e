"""Parts of the library against makers' tables, and scenes that name them."""

import argparse
import tomllib

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.cli import library as command
from dropper_jax.load.library import FAMILIES, part, published_crops

POUND = 4.4482216


#: Values of parts: breaking loads [N] of makers' tables, which are mooring chain (34 to 70 mm of R3 and R4), stud-link
#: anchor chain (1 5/8 in of grades 2 and 3), floating and polyester mooring rope (20 and 24 mm); the paper's chain.
PUBLISHED = [
    ("chain-studless-r3-0.034", "breaking_load", 1065e3, 0.005),
    ("chain-studless-r3-0.07", "breaking_load", 4196e3, 0.005),
    ("chain-studlink-r4-0.034", "breaking_load", 1308e3, 0.005),
    ("chain-studlink-r4-0.05", "breaking_load", 2740e3, 0.005),
    ("chain-studlink-0.041275", "breaking_load", 214000 * POUND, 0.01),
    ("chain-studlink-u3-0.041275", "breaking_load", 306000 * POUND, 0.01),
    ("rope-polypropylene-0.02", "breaking_load", 40e3, 0.1),
    ("rope-polyester-plaited-0.024", "breaking_load", 102e3, 0.05),
    ("chain-studlink-0.022", "EA", 48_884_000.0, 1e-6),
    ("chain-studlink-0.022", "diameter", 0.042, 0.02),
    ("chain-studlink-0.022", "mass", 10.91, 0.03),
]


@pytest.mark.parametrize(("name", "key", "value", "near"), PUBLISHED)
def test_parts_have_published_values(name, key, value, near):
    assert part(name)[1][key] == pytest.approx(value, rel=near)


@pytest.mark.parametrize(
    ("name", "density"),
    [
        ("chain-studless-0.03", 7850.0),
        ("chain-studlink-0.03", 7850.0),
        ("rope-polyester-0.03", 1380.0),
        ("rope-nylon-plaited-0.03", 1140.0),
        ("rope-polypropylene-0.03", 910.0),
        ("rope-hmpe-0.03", 975.0),
    ],
)
def test_displaced_diameters_have_the_density_of_the_material(name, density):
    values = part(name)[1]
    assert values["mass"] / (0.25 * np.pi * values["diameter"] ** 2) == pytest.approx(density, rel=0.02)


def scene(kind="library:chain-studlink-0.022", point="library:float-0.3"):
    return {
        "run": {"dt": 0.02, "duration": 1.0},
        "sea": {"depth": 30.0},
        "point": [
            {"name": "anchor", "position": [0.0, 0.0, -30.0]},
            {"name": "top", "position": [20.0, 0.0, -2.0], "type": point},
        ],
        "line": [{"name": "leg", "from": "anchor", "to": "top", "type": kind, "length": 40.0, "links": 8}],
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "seabed": {}},
    }


def test_a_scene_names_parts_and_is_written_back_whole():
    found = dj.load_scene(scene())
    chain = part("chain-studlink-0.022")[1]
    assert np.allclose(found.lines[0].mass, chain["mass"] * 5.0)
    assert np.allclose(found.effects["morison_drag"]["cdn"], chain["cdn"])
    assert found.points[1].volume == 0.3
    assert found.points[1].mass == pytest.approx(24.0)
    written = found.as_written()
    assert written["line_type"] == [chain]
    assert dj.load_scene(written) == found
    softer = found.with_values({"line_type.library:chain-studlink-0.022.EA": 1e7})
    assert np.all(softer.lines[0].EA == 1e7)


@pytest.mark.parametrize(
    ("kind", "point", "printed"),
    [
        ("library:chain-studless", "library:float-1", "has no size"),
        ("library:chain-stdless-0.02", "library:float-1", "did you mean 'chain-studless-0.022'"),
        ("library:rope-nylon-x", "library:float-1", "'x' is not a number"),
        ("library:rope-nylon-30", "library:float-1", "allowed: 0.005 to 0.3 m"),
        ("library:float-0.2", "library:float-1", "a part for points"),
        ("library:kelp-5", "library:kelp-5", "a part for lines"),
        ("library:kelp-5", "library:float-nan", "is not a number"),
    ],
)
def test_parts_that_do_not_exist_are_named(kind, point, printed):
    with pytest.raises(SceneError, match=printed) as found:
        dj.load_scene(scene(kind, point))
    assert str(found.value).startswith(("line.0.type: ", "point.1.type: "))


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_prints_a_block_that_a_scene_takes(family, capsys):
    name = f"{family}-{FAMILIES[family].example:g}"
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    assert command.run(parser.parse_args([name])) == 0
    block = tomllib.loads(capsys.readouterr().out)
    table = scene()
    if "point" in block:
        table["point"][1] = {**block["point"][0], "name": "top"}
    else:
        table |= block
        table["line"][0]["type"] = name
    assert dj.load_scene(table).lines[0].links == 8


def test_drag_of_a_half_grown_dropper_of_the_library_is_the_published_one():
    """1/2 rho Cd D U^2 per metre across a vertical dropper: 0.13 m, Cd 1.3, 7.53 kg/m (Zhu et al. 2020)."""
    speed, links = 0.5, 8
    table = scene("library:mussel-dropper-7.53")
    table["sea"]["current"] = {"kind": "uniform", "speed": speed, "direction": np.pi / 2}
    table["line"][0]["length"] = 8.0
    model = dj.build(table)[0]
    assert np.allclose(model.line.mass, 7.53 * 8.0 / links)
    r = np.zeros((model.free_nodes, 3))
    r[:, 2] = -30.0 + np.arange(1, links + 1)
    instant = model.instant(r, 0.0 * r, 0.0)
    drag = np.asarray(model.effect("morison_drag").force(instant))[1:-1, 1]
    published = 0.5 * 1025.0 * 1.3 * 0.13 * speed**2
    assert drag[1:4] == pytest.approx(published, rel=0.1)


def test_a_lighter_dropper_of_the_library_is_the_one_published_for_january():
    january = next(crop for crop in published_crops() if crop["mass"] == 4.46)
    values = part("mussel-dropper-4.46")[1]
    assert values["outer_diameter"] == pytest.approx(january["outer_diameter"], rel=0.01)
    assert values["cdn"] == january["cdn"]
    assert values["can"] == january["can"]


def test_every_published_crop_states_its_source_and_resembles_a_family():
    for crop in published_crops():
        assert crop["read"]
        assert FAMILIES[crop["like"]].spread
        missing = all(crop[key] is None for key in ("mass", "outer_diameter", "cdn", "can", "EI"))
        assert missing == ("not at hand" in crop["read"])
