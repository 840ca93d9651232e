"""Slips of users on the command line, each refused in one line that names the field, the value and the way out."""

import shlex

import pytest

from dropper_jax.cli.new import template
from fitting.farm.site import site_text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene, a site, a table without rows, a folder that is not a saved run."""
    found = tmp_path_factory.mktemp("words")
    for kind in ("longline", "mussels"):
        (found / f"{kind}.toml").write_text(template(kind), encoding="utf-8")
    (found / "site.toml").write_bytes(site_text("small-longline"))
    (found / "empty.csv").write_text("hs,tp\n", encoding="utf-8")
    (found / "other.zarr").mkdir()
    return found


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run site.toml", "scene: this is a site, not a scene. Use it with cases, season or optimise"),
        ("cases longline.toml --list", "line: this is a scene, not a site; `dropper cases small-longline --print`"),
        ("run longline.toml --set sea.waves.direction=270", "sea.waves.direction: 270 is out of range; allowed: a"),
        ("check longline.toml --set sea.current.direction=-90", "sea.current.direction: -90 is out of range"),
        ("check longline.toml --set line.west-leg.length=-3", "line.west-leg.length: -3 is out of range; allowed: a"),
        ("check longline.toml --set line_type.rope.EA=stiff", "line_type.rope.EA: 'stiff' is not a number; allowed: a"),
        ("sweep string --vary b_l=0:1:0 --out x.zarr", "--vary: 'b_l=0:1:0' is not NAME=LO:HI:N; allowed: N >= 1"),
        ("design paper-case-4 --vary line.0.length=52:51 --target x.0 --value 3", "length: 52 to 51 is an empty range"),
        ("design paper-case-4 --vary line.0.length=51:52 --target x.0 --value nan", "value: nan of x.0 is not finite"),
        ("plan string --free b_l --rate 60,120", "'60,120' is not a number"),
        ("scenes string --dt 0.1", "--dt: requires --moordyn FILE"),
        ("equilibrium edulis-tide --times 7", "--times: requires --tide"),
        ("sea dropper-current --flow flow.png --regimes waves.png", "--regimes: scene 'dropper-current' has no waves"),
        (f"check string --out {'a' * 245}.json", "File name too long"),
        ("fit empty.csv --scene string --report fitted", "empty.csv: has fewer than two rows of numbers"),
        ("sweep string --vary b_l=0,1 --vary b_l=2,3 --out x.zarr", "--vary: 'b_l' is given twice; allowed: every"),
        ("sensitivity string --of tension.max --to b_l --range b_l=0:1", "--range: requires --global sobol or morris"),
        ("sensitivity string --of tension.max --to b_l --check --global sobol", "--check: derivatives are not part of"),
        ("run string --out other.zarr", "other.zarr: exists and is not a saved run. Use a new folder"),
        ("sweep string --listed x.csv --out x.zarr", "unrecognized arguments: --listed x.csv"),
        ("growth mussels.toml --months 13", "--months: 13 is out of range; allowed: 0 to 12 months"),
        ("growth longline.toml", "`density`, as `dropper new mussels` writes"),
        ("frequency edulis-longline --table empty.csv", "--table: 'empty.csv' has no rows"),
        ("demo --out empty.csv", "--out: 'empty.csv' is a file; allowed: a folder"),
        ("run string --plot empty.csv/pictures", "--plot: 'empty.csv/pictures' cannot be made in"),
    ],
)
def test_a_slip_is_refused_in_one_line_and_leaves_no_file(folder, monkeypatch, refused, line, words):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert words in refused(shlex.split(line))
    assert sorted(folder.iterdir()) == before


def test_check_counts_mussels_in_the_mass_of_a_line(folder, json_of):
    found = json_of(["check", str(folder / "mussels.toml"), "--json"])
    row, weights = found["lines"][0], found["line_weights"][0]
    assert row["mass_kg"] == pytest.approx(row["length_m"] * weights["mass_kg_per_m"])
    assert row["wet_weight_n"] == pytest.approx(row["length_m"] * weights["wet_weight_n_per_m"])
    assert weights["mass_kg_per_m"] > 5.0  # the bare rope has 0.8 kg/m
