"""Every declared value of a scene is in its MoorDyn deck, refused, or listed as lost."""

import copy
import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropper_jax import Scene, SceneError, load_scene, write_moordyn
from dropper_jax.base.read import section_keys
from dropper_jax.decks.writing.differences import MOTIONS, WRITTEN_FIELDS
from dropper_jax.load.line_types import LineType
from dropper_jax.modelling import growth
from dropper_jax.scene import (
    AnchorSpec,
    BodySpec,
    BuoySpec,
    CylinderSpec,
    FailureSpec,
    GrowthSpec,
    LineSpec,
    PointSpec,
    RaoSpec,
    RunSpec,
    SeasonSpec,
    SphereSpec,
    StartSpec,
    VesselSpec,
)
from dropper_jax.sea.current_spec import CurrentSpec, LevelSpec
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.wave_spec import WaveSpec

GROWTH = {"depth": [0.0, 20.0], "thickness": [0.02, 0.03], "density": 1200.0}
SEASON = {"lines": ["leg"], "month": 2.0, "months": [0.0, 4.0], "depth": [0.0, 20.0], "density": 1200.0}
SEASON |= {"thickness": [[0.0, 0.0], [0.04, 0.05]]}
TABLE = {"law": "tabulated", "strain": [0.0, 0.1], "tension": [0.0, 1e4]}
RAO = {"frequency": [0.5, 1.0], "headings": [0.0, 1.0], "phases": "lead", "heave": [[1.0, 0.5], [1.0, 0.5]]}
SPECTRUM = {"kind": "spectrum", "hs": 1.0, "tp": 6.0, "count": 4, "directions": 2, "spreading": 5.0}
STREAM = {"kind": "regular", "height": 1.0, "period": 6.0, "theory": "stream"}

#: A scene with one of each thing; each case below changes it first, and then one value.
BASE: dict[str, Any] = tomllib.loads(Path(__file__).with_name("all.toml").read_text())
#: A line given by the link, in place of the lines by the metre.
BY_LINK = {"links": 4, "length": 7.5, "mass": 40.0, "diameter": 0.05, "axial": {"law": "rope", "EA": 1e6}}
PLAIN_LINES = [
    {"name": line["name"], "from": line["from"], "to": line["to"], **BY_LINK, "links": line["links"], "nodes": "shared"}
    for line in BASE["line"]
]
COEFFICIENTS = {"effects.morison_drag": {"cdn": 1.2, "cdt": 0.1}, "effects.morison_inertia": {"can": 1.0, "cat": 0.0}}
LINKS: dict[str, Any] = {"line_type": None, "line": PLAIN_LINES, **COEFFICIENTS}

RAMP = {"sea.ramp": 5.0}
#: What follows from other values, which have cases of their own, or what systems of lines refuse as they are read.
NO_CASE: dict[type, set[str]] = {
    Scene: {"points", "lines", "effects", "start", "run", "sea", "buoys", "failures", "anchors", "bodies", "vessels"}
    | {"written", "template", "before_links"},
    PointSpec: {"carrier"},
    # rows of the deck are type1, type2, ..., one for each kind of link; no law of the package has further constants
    LineType: {"name", "constants"},
    LineSpec: {"centre_of_mass", "inertia", "constants"},
    RunSpec: {"options", "suggested_step", "suggested_interval"},
    StartSpec: {"release_nodes", "release_force", "polar", "azimuth", "polar_rate", "azimuth_rate", "zero"}
    | {"positions", "velocities"},
    WaveSpec: {"file"},  # read into components
}


def values_of(cls: type) -> list[tuple[str, str, Any, dict[str, Any]]]:
    """Rows of declared name, path in the scene, other value, and what is changed first."""

    def rows(path: str, first: dict[str, Any] | None = None, **values: Any) -> list:
        return [(key, f"{path}.{key}", value, first or {}) for key, value in values.items()]

    if cls is Scene:
        found = [("name", "name", "other", {}), ("description", "description", "words", {})]
        found += [("notes", "notes", ["deck.txt: tScheme is not used"], {}), ("season", "growth", SEASON, {})]
        return [*found, ("fit", "fit", {"free": ["line.0.mass"]}, {})]
    if cls is PointSpec:
        found = rows("point.1", position=[21.0, 0.0, -2.0], mass=11.0, volume=0.11, drag_area=0.5, added_mass=0.5)
        found += rows("point.1", {"point.1": {"name": "float", "position": [20.0, 0.0, -2.0]}}, kind="free")
        return [*found, ("name", "", {"point.2.name": "knot", "line.3.to": "knot", "buoy.0.point": "knot"}, {})]
    if cls is BuoySpec:
        found = rows("buoy.0", name="tin", point="float", mass=210.0, diameter=0.7, height=1.6, attachment=0.2)
        return [*found, *rows("buoy.0", cdn=1.1, cdt=0.1, can=0.9, cat=0.2, end_added_mass="volume")]
    if cls is LineType:
        found = rows("line_type.0", mass=6.0, diameter=0.06, EA=2e6, law="damped_rope", damping=100.0)
        found += rows(
            "line_type.0", damping_ratio=0.1, breaking_load=1e5, outer_diameter=0.07, cdn=1.3, cdt=0.2, can=0.9, cat=0.1
        )
        found += rows("line_type.0", {"effects.bending": {}, "line_type.0.EI": 40.0}, EI=50.0)
        tabulated = {"line_type.0": {**BASE["line_type"][0], **TABLE}, "line_type.0.EA": None}
        return [*found, *rows("line_type.0", tabulated, strain=[0.0, 0.2], tension=[0.0, 2e4])]
    if cls is LineSpec:
        found = rows("line.0", {"failure": []}, name="foot")
        found += [("start", "line.0.from", "mooring", {}), ("end", "line.0.to", "eye", {})]
        found += rows(
            "line.0",
            LINKS,
            links=5,
            length=8.0,
            mass=41.0,
            diameter=0.06,
            outer_diameter=0.07,
            breaking_load=1e5,
            nodes="far",
        )
        found += [("EA", "line.0.axial.EA", 2e6, LINKS), ("axial_damping", "line.0.axial.damping", 10.0, LINKS)]
        for key, law in (("axial_law", {"law": "elastic", "EA": 1e6}), ("tables", TABLE)):
            found.append((key, "", {f"line.{i}.axial": law for i in range(4)}, LINKS))
        found += rows("line.0", growth=GROWTH)
        hauled = {"end": "from", "links": 1, "time": [0.0, 1e4], "length": [7.5, 7.4]}
        found += rows("line.0", LINKS, length_in_time=[hauled])
        found += rows("line.0", {**LINKS, "failure": []}, piece_of="whole")
        # keys of lines by the metre
        found += rows("line.0", shelter=0.6)
        found += rows("line.0", {"failure": []}, attach=[{"point": "knot", "at": 10.0}])
        parts = [{"type": "rope", "length": 12.0, "links": 2}, {"type": "rope", "length": 18.0, "links": 2}]
        given = {f"line.0.{key}": None for key in ("type", "length", "links")}
        return [*found, ("sections", "", {**given, "line.0.sections": parts}, {"failure": []})]
    if cls is GrowthSpec:
        grown = {"line.0.growth": GROWTH}
        return rows("line.0.growth", grown, depth=[0.0, 15.0], thickness=[0.03, 0.04], density=1100.0)
    if cls is SeasonSpec:
        found = rows("growth", {"growth": SEASON}, lines=["leg", "bridle"], month=3.0, months=[0.0, 5.0])
        found += rows(
            "growth", {"growth": SEASON}, depth=[0.0, 15.0], density=1100.0, thickness=[[0.0] * 2, [0.03] * 2]
        )
        found += rows("growth", {"growth": SEASON}, harvested=0.5, deviation=0.2)
        held = {"growth": {**SEASON, "attachment": 1.0, "mussel_mass": 0.01}}
        found += rows("growth", held, attachment=2.0, mussel_mass=0.02)
        found += rows("growth", {"growth": {**SEASON, "harvested": 0.5}}, harvested_lines=["tail"])
        return [*found, *rows("growth", {"growth": {**SEASON, "deviation": 0.2}}, correlation=2.0, seed=3)]
    if cls is BodySpec:
        found = rows("body.0", name="barge-2", position=[30.0, 6.0, -1.0], mass=510.0, centre_of_mass=[0.0, 0.0, 0.1])
        found += rows("body.0", inertia=[110.0, 100.0, 50.0], attitude=[0.1, 0.0, 0.0], velocity=[0.1, 0.0, 0.0])
        found += rows("body.0", angular_velocity=[0.1, 0.0, 0.0], touches_bed=True, pinned=True, spheres=[])
        found += rows("body.0", {"body.0.touches_bed": True}, bed_friction=0.2)
        return [*found, *rows("body.0", cylinders=[], attachments={"eye": [0.0, 0.1, 0.0]})]
    if cls is CylinderSpec:
        found = rows("body.0.cylinders.0", diameter=1.1, slices=9, cdn=1.1, cdt=0.1, can=0.9, cat=0.1, ends="to")
        cylinder = "body.0.cylinders.0"
        found += [("start", f"{cylinder}.from", [0.0, 0.0, -0.6], {}), ("end", f"{cylinder}.to", [0.0, 0.0, 1.1], {})]
        return found
    if cls is SphereSpec:
        return rows("body.0.spheres.0", centre=[0.1, 0.0, 0.0], diameter=0.6, cd=0.6, ca=0.6)
    if cls is VesselSpec:
        found = rows("vessel.0", name="ship", position=[41.0, 0.0, 0.0], heading=0.5, time=[0.0, 2.0])
        found += rows("vessel.0", motion=[[0.0] * 6, [2.0] + [0.0] * 5], attachments={"fairlead": [-3.0, 0.0, 0.0]})
        return [*found, ("rao", "", {"vessel.0.time": None, "vessel.0.motion": None, "vessel.0.rao": RAO}, RAMP)]
    if cls is RaoSpec:
        moved = {"vessel.0.time": None, "vessel.0.motion": None, "vessel.0.rao": RAO, **RAMP}
        found = rows("vessel.0.rao", moved, frequency=[0.5, 1.1], headings=[0.0, 1.1], phases="lag")
        found += [("amplitude", "vessel.0.rao.heave", [[2.0, 0.5], [1.0, 0.5]], moved)]
        return [*found, ("phase", "vessel.0.rao.heave_phase", [[1.0, 0.5], [1.0, 0.5]], moved)]
    if cls is SeaSpec:
        found = rows("sea", depth=21.0, density=1000.0, gravity=9.8, ramp=5.0, stretching="none", dispersion="fenton")
        found += rows("sea", wave_current="doppler", interpolation="grid", level={"offset": 0.5})
        return [*found, *rows("sea", waves=None, current=None)]
    if cls is WaveSpec:
        found = rows("sea.waves", amplitude=0.6, period=7.0, phase=0.5, direction=0.5, theory="stokes5", kind="regular")
        found[-1] = ("kind", "sea.waves", SPECTRUM, {})
        for key, value, less in (("height", 1.2, "amplitude"), ("length", 40.0, "period")):
            found.append((key, "", {f"sea.waves.{less}": None, f"sea.waves.{key}": value}, {}))
        drawn = {"sea.waves": SPECTRUM}
        found += rows("sea.waves", drawn, spectrum="pierson_moskowitz", hs=1.1, tp=7.0, gamma=2.0, count=5, seed=1)
        found += rows("sea.waves", drawn, frequencies="even", spreading=6.0, directions=3)
        return [*found, *rows("sea.waves", {"sea.waves": STREAM}, order=6, current_criterion="stokes")]
    if cls is CurrentSpec:
        found = rows("sea.current", speed=1.1, direction=0.5, veer=0.01)
        power = {"sea.current": {"kind": "power", "speed": 1.0, "exponent": 0.2, "reference": -1.0}}
        found.append(("kind", "", power, {}))
        found += rows("sea.current", power, exponent=0.3, reference=-2.0)
        table = {"sea.current": {"kind": "table", "heights": [-20.0, 0.0], "velocities": [[0.0] * 3, [1.0, 0.0, 0.0]]}}
        found += rows("sea.current", table, heights=[-15.0, 0.0], velocities=[[0.0] * 3, [2.0, 0.0, 0.0]])
        timed = {"sea.current": {"speed": 1.0, "time": [0.0, 1.0], "factor": [1.0, 2.0]}}
        found += rows("sea.current", timed, time=[0.0, 2.0], factor=[1.0, 3.0])
        tide = {"sea.current": {"speed": 1.0, "amplitude": [1.0], "period": [4e4], "phase": [0.0]}}
        return [*found, *rows("sea.current", tide, amplitude=[1.1], period=[5e4], phase=[0.1])]
    if cls is LevelSpec:
        found = rows("sea.level", {"sea.level": {"offset": 0.5}}, offset=0.6)
        timed = {"sea.level": {"time": [0.0, 1.0], "height": [0.0, 1.0]}}
        found += rows("sea.level", timed, time=[0.0, 2.0], height=[0.0, 0.5])
        tide = {"sea.level": {"amplitude": [1.0], "period": [4e4], "phase": [0.0]}}
        return [*found, *rows("sea.level", tide, amplitude=[1.1], period=[5e4], phase=[0.1])]
    if cls is StartSpec:
        return [("kind", "start", {"kind": "points"}, {})]
    if cls is RunSpec:
        found = rows("run", dt=0.05, duration=2.0, integrator="theta", solver="dense", dtype="float32", save_every=2)
        return [
            *found,
            *rows("run", accuracy=0.01, save_interval=0.5),
            *rows("run", {"run.accuracy": 0.01}, source_dt=0.01),
        ]
    if cls is FailureSpec:
        found = rows("failure.0", line="tail", link=2, load=1e4, time=0.6)
        return found
    found = rows("anchor.0", point="fairlead", weight=2e4, friction=0.6, safety_factor=2.0)
    tested = {"anchor.0": {"point": "anchor", "kind": "tested", "capacity": 1e4}}
    found += rows("anchor.0", tested, kind="tested", capacity=2e4)
    found += rows(
        "anchor.0", {"anchor": [*tested.values(), {**BASE["anchor"][0], "point": "fairlead"}]}, behind="fairlead"
    )
    screw = {"point": "anchor", "kind": "screw", "plates": [0.3], "depths": [3.0]}
    clay, sand = {**screw, "strength": 5e4}, {**screw, "friction_angle": 0.5, "soil_weight": 1e4}
    found += rows("anchor.0", {"anchor.0": clay}, plates=[0.4], depths=[4.0], strength=6e4, lateral=1e4)
    return [*found, *rows("anchor.0", {"anchor.0": sand}, friction_angle=0.6, soil_weight=9e3, bearing_factor=20.0)]


#: Notes that list whole things, whose values change no file.
WHOLE = {
    AnchorSpec: r"anchor at 'anchor': its resistance is not represented",
    RaoSpec: r"point 'fairlead' is Coupled; its motion is not in the file",
    VesselSpec: r"point 'fairlead' is Coupled; its motion is not in the file",
    LevelSpec: r"sea.level: not represented",
    WaveSpec: r"sea.waves.theory: 'stream' is not represented",
    CurrentSpec: r"sea.current.(time|amplitude): not represented; the current is steady",
    SeasonSpec: r"growth.attachment: not represented",
}
CLASSES = (Scene, PointSpec, BuoySpec, LineType, LineSpec, GrowthSpec, SeasonSpec, BodySpec, CylinderSpec, SphereSpec)
CLASSES += (VesselSpec, RaoSpec, SeaSpec, WaveSpec, CurrentSpec, LevelSpec, StartSpec, RunSpec, FailureSpec, AnchorSpec)


def put(table: dict[str, Any], path: str, value: Any) -> None:
    *way, last = path.split(".")
    for key in way:
        table = table[int(key)] if isinstance(table, list) else table[key]
    if isinstance(table, list):
        table[int(last)] = copy.deepcopy(value)
    elif value is None:
        table.pop(last, None)
    else:
        table[last] = copy.deepcopy(value)


def made(changes: dict[str, Any]) -> dict[str, Any]:
    table = copy.deepcopy(BASE)
    for path, value in changes.items():
        put(table, path, value)
    return table


def export(changes: dict[str, Any], folder: Path, scene: Scene | None = None) -> tuple[dict[str, str], list[str]]:
    folder.mkdir()
    notes = write_moordyn(scene or load_scene(made(changes)), folder / "deck.txt")
    return {file.name: file.read_text() for file in folder.iterdir()}, notes


@pytest.fixture(autouse=True)
def some_pose(monkeypatch):
    """Grown lines need depths of their links; which ones does not matter here."""
    nodes = sum(line["links"] for line in BASE["line"]) + len(BASE["line"])
    places = np.stack([np.zeros(nodes), np.zeros(nodes), np.linspace(-20.0, 0.0, nodes)], axis=1)
    monkeypatch.setattr(growth, "resting_nodes", lambda scene, model: places)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_value_is_written_refused_or_listed(cls, tmp_path):
    cases = values_of(cls)
    assert {f.name for f in dataclasses.fields(cls)} - NO_CASE.get(cls, set()) <= {key for key, *_ in cases}
    lost, known = [], {}
    for i, (key, path, value, first) in enumerate(cases):
        before = known.get(repr(first)) or known.setdefault(repr(first), export(first, tmp_path / f"{i}-before"))
        scene = load_scene(made({**first, **({path: value} if path else value)}))  # valid: only its deck may be refused
        try:
            after = export({}, tmp_path / f"{i}-after", scene)
        except SceneError:
            continue
        listed = cls in WHOLE and any(re.search(WHOLE[cls], note) for note in after[1])
        if after == before and not listed:
            lost.append(key)
    assert lost == []


def test_every_section_has_cases():
    classes = {"point", "line", "buoy", "body", "vessel", "start", "run", "sea", "failure", "anchor"}
    assert {*section_keys(Scene)} == {*classes, "name", "description", "notes", "fit", "growth", "effects"}


def test_values_of_effects_that_a_deck_has_are_written_or_listed(tmp_path):
    """The others are listed by name, see `test_every_value_of_an_effect_that_a_file_cannot_have_is_listed_as_lost`."""
    cases: dict[str, dict[str, Any]] = {
        "weight": {"gravity": 9.8},  # wet_weight has no buoyancy next to it
        "morison_drag": {"cdn": 1.1, "cdt": 0.2},
        "morison_inertia": {"can": 0.9, "cat": 0.1, "fluid_acceleration": "material", "added_mass": "lagrangian"},
        "seabed": {"stiffness": 1e6, "damping": 1e5, "depth": 25.0},
        "seabed_friction": {"kinetic": 0.6, "static": 0.9, "damping": 150.0, "law": "moordyn"},
        "bending": {"EI": 50.0, "clamped": ["fairlead"]},
    }
    no_case = {"morison_drag": {"tangents"}, "bending": {"directions"}, "seabed": {"bed_x", "bed_y", "bed_depth"}}
    no_case["weight"] = {"wet_weight"}
    moved = {name: set(WRITTEN_FIELDS[name]) for name in MOTIONS if name in WRITTEN_FIELDS}
    for name, keys in WRITTEN_FIELDS.items():
        assert {*keys} == {*cases.get(name, ())} | no_case.get(name, set()) | moved.get(name, set())
    first = {"effects.seabed_friction": {"kinetic": 0.5}, "line_type.0.EI": 40.0, "effects.bending": {}}
    before = export(first, tmp_path / "before")
    for name, values in cases.items():
        for key, value in values.items():
            changes = {f"effects.{name}.{key}": value}
            if key == "clamped":
                changes["effects.bending.directions"] = [[1.0, 0.0, 0.0]]
            assert export({**first, **changes}, tmp_path / f"{name}-{key}") != before, key
    bed = {"bed_x": [-50.0, 50.0], "bed_y": [-50.0, 50.0], "bed_depth": [20.0, 25.0] * 2}
    written = {
        export({"effects.seabed": {**bed, **change}}, tmp_path / str(i))[0]["deck-seafloor.txt"]
        for i, change in enumerate(
            ({}, {"bed_x": [-60.0, 50.0]}, {"bed_y": [-60.0, 50.0]}, {"bed_depth": [20.0, 26.0] * 2})
        )
    }
    assert len(written) == 4
