"""SITE.toml: read and checked against its scene; invalid input is rejected in one line."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import (
    Table,
    Values,
    check_keys,
    plain,
    read_items,
    read_list,
    read_number,
    read_table,
    read_text,
)
from dropper_jax.base.records import names_of
from dropper_jax.load.packaged import find_scene, is_packaged, parse_toml
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.growth import overgrown
from dropper_jax.modelling.scene_model import bare_model
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.quantities.statistics import PERIOD
from dropper_jax.scene import whole_lines
from fitting.farm.site.case_lists import CaseLists
from fitting.farm.site.checks import check_breaking, check_currents, check_hours, check_times, check_waters
from fitting.farm.site.parts import read_anchors, read_parts, refuse_duplicates
from fitting.farm.site.patterns import match_names
from fitting.farm.site.sections import Backbone, Exclusion, Factors, GrowthTable, RunValues, SeasonValues, SeaState
from fitting.farm.site.site import Site, water_of
from fitting.farm.site.states import BROKEN, kinds_of, read_states

#: Sections that are read here, and those that other modules read.
SITE_KEYS = (
    *("name", "description", "scene", "unchecked", "parameters", "set", "run", "sea_state", "cases"),
    *("growth", "crop", "factors", "part", "anchor", "exclusion", "backbone", "season", "quantities"),
)
PASSED = ("variable", "objective", "constraint", "optimise")
#: Sections that a site may lack, with their classes.
OPTIONAL = {"exclusion": Exclusion, "backbone": Backbone, "season": SeasonValues}
#: Values of a number of `[crop]`, in order.
CROP_LEVELS = ("low", "expected", "high")
#: Tables of a scene that are set as one value.
REPLACED_TABLES = ("sea.waves", "sea.current", "sea.level")


def read_site(source: str | Path | Values) -> Site:
    """The site of a TOML file, of a packaged name, or of plain values.

    Raises:
        SceneError: one line with the section, the value and the allowed range.
    """
    file = None if isinstance(source, Mapping) else Path(source)
    table = _site_table(source)
    scene = _scene(table, (file or Path()).parent)
    water_of(scene)
    lines = tuple(names_of(whole_lines(scene)))
    run = RunValues.read(table.get("run", {}), "run")
    lists = CaseLists.read(table.get("cases", {}), "cases")
    states = read_items(SeaState.read, table.get("sea_state", []), "sea_state", needed=True)
    refuse_duplicates("sea_state", names_of(states))
    check_hours(states)
    broken = read_states(scene, lists.states, "cases.states")
    kinds = kinds_of(broken)
    check_times(run, lists, BROKEN in kinds)
    factors = Factors.read(table.get("factors", {}), "factors")
    growth = _growth(table, lines)
    crop = _crop(table)
    _check_names(lists.months, growth, "cases.months", "growth")
    _check_names(lists.crops, crop, "cases.crops", "crop")
    default_name = file.stem if file else scene.name
    site = Site(
        name=read_text(table.get("name", default_name), "name"),
        description=read_text(table.get("description", ""), "description"),
        scene=scene,
        run=run,
        sea_states=states,
        lists=lists,
        growth=growth,
        crop=crop,
        states=broken,
        factors=factors,
        parts=read_parts(table, scene, lines, factors, kinds),
        anchors=read_anchors(table, scene, factors, kinds),
        quantities=_quantities(table, scene),
        raw={key: plain(table[key]) for key in PASSED if key in table},
        table={key: plain(value) for key, value in table.items()},
        file=file,
        **_optional_sections(table, scene, lines),
    )
    check_currents(site)
    check_breaking(site)
    check_waters(site)
    return site


def _site_table(source: str | Path | Values) -> Values:
    """The table of a TOML file, of a packaged name, or as given; its keys are checked."""
    if isinstance(source, Mapping):
        table = source
    else:
        table = parse_toml(site_text(source), str(Path(source)))
    if "line" in table:
        raise SceneError(
            "line: this is a scene, not a site; `dropper cases small-longline --print` prints a site to edit"
        )
    check_keys(table, (*SITE_KEYS, *PASSED), "")
    return table


def _check_names(names: Sequence[str], existing: Collection[str], path: str, section: str) -> None:
    """Reject names at a path that a section of the site does not have, and duplicates."""
    if names and not existing:
        raise SceneError(f"{section}: missing; needed: {', '.join(names)}, named in {path}")
    for i, name in enumerate(names):
        read_text(name, f"{path}.{i}", existing)
    refuse_duplicates(path, names)


def _optional_sections(table: Values, scene: Scene, lines: tuple[str, ...]) -> Table:
    """The sections of `OPTIONAL` that the site has, by name, with patterns that match its lines and points."""
    sections: Table = {name: cls.read(table[name], name) for name, cls in OPTIONAL.items() if name in table}
    for name, section in sections.items():
        if name == "season":
            match_names(section.points, scene.free_points, "season.points", "free point")
        else:
            match_names(section.lines, lines, f"{name}.lines")
    return sections


def _quantities(table: Values, scene: Scene) -> tuple[str, ...]:
    """Names of the quantities to report, checked with the model of the scene."""
    names = [read_text(x, "quantities") for x in read_list(table.get("quantities", []), "quantities", None, "names")]
    if names:
        model = bare_model(overgrown(scene))
        for name in names:
            if quantity(name, model, "quantities").signal == PERIOD:
                raise SceneError(f"quantities: {name!r} belongs to the static pose. Use `dropper modes`")
    refuse_duplicates("quantities", names)
    return tuple(names)


def packaged_sites() -> dict[str, Traversable]:
    """Files of the packaged sites by name."""
    items = (resources.files("dropper_jax") / "data" / "sites").iterdir()
    return {item.name.removesuffix(".toml"): item for item in items if item.name.endswith(".toml")}


def site_text(source: str | Path) -> bytes:
    """The text of a site's file, or of a packaged site.

    Raises:
        SceneError: neither a file nor a packaged site has this name.
    """
    file = Path(source)
    packaged = packaged_sites()
    if str(source) in packaged and not file.exists():
        return packaged[str(source)].read_bytes()
    try:
        return file.read_bytes()
    except OSError as error:
        hint = nearest(str(source), packaged)
        if file.suffix:
            hint = "see `dropper cases small-longline --print`"
        raise SceneError(f"site: cannot read {str(file)!r}: {error.strerror or error}; {hint}") from None


def _scene(table: Values, folder: Path) -> Scene:
    """The scene with the values of `[parameters]` and `[set]`."""
    if "scene" not in table:
        raise SceneError("scene: missing; needed: a scene's file in this folder, or the name of a packaged scene")
    given = table["scene"]
    if isinstance(given, Mapping):
        scene = Scene.from_dict(given)
    else:
        source: str | Path = read_text(given, "scene")
        if not is_packaged(source) and (folder / source).exists():
            source = folder / source
        scene = Scene.from_dict(*find_scene(source))
    values = {f"parameters.{key}": value for key, value in _table(table, "parameters").items()}
    values |= _flat(_table(table, "set"))
    if not values:
        return scene
    return scene.with_values(values)


def _table(table: Values, key: str) -> Values:
    """The table at a key, empty if it is missing."""
    return read_table(table.get(key, {}), key)


def _flat(table: Values, path: str = "") -> Table:
    """Values by path, `sea.depth = 25` with or without quotes; waves and currents are set as whole tables."""
    found: Table = {}
    for key, value in table.items():
        inner = f"{path}.{key}" if path else key
        if isinstance(value, Mapping) and inner not in REPLACED_TABLES:
            found |= _flat(value, inner)
        else:
            found[inner] = value
    return found


def _growth(table: Values, lines: tuple[str, ...]) -> dict[str, dict[str, Table]]:
    """Tables of `[line.growth]` by month and line."""
    found: dict[str, dict[str, Table]] = {}
    for own in read_items(GrowthTable.read, table.get("growth", []), "growth"):
        month = found.setdefault(own.month, {})
        path = f"growth.{own.month}.lines"
        for name in match_names(own.lines, lines, path):
            if name in month:
                raise SceneError(f"{path}: {name!r} already has mussels in this month; allowed: once a month")
            month[name] = own.growth.table()
    return found


def _crop(table: Values) -> dict[str, dict[str, float]]:
    """Values of `[crop]` by level and path; empty without the section."""
    found: dict[str, dict[str, float]] = {}
    for path, row in _flat(_table(table, "crop")).items():
        entries = read_list(row, f"crop.{path}", 3, "three numbers")
        values = [read_number(entry, f"crop.{path}", {}, "a number") for entry in entries]
        if values != sorted(values):
            raise SceneError(f"crop.{path}: {values}; allowed: low <= expected <= high")
        for level, value in zip(CROP_LEVELS, values, strict=True):
            found.setdefault(level, {})[path] = value
    return found
