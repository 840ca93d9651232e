"""Every table of the thesis and the paper and what is here: the numbers of docs/checked-against.md.

    python benchmarks/sources.py [--poses]

Takes about a minute. Writes results/sources.json, of which `python benchmarks/tables.py` makes tables.

`--poses`: static release poses against the measured ones. For each scenario of the lab experiment the two components of
the force at the lifted node are fitted to the mean link angles of the measured runs, with equivalent simple links
(either order of the two kinds) and with the compound bars. The misfits are printed, in Markdown.
"""

import csv
import tomllib
from collections.abc import Iterator
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
from figure_table import TABLE
from scipy.optimize import least_squares
from study import command, show, store

import dropper_jax as dj
from dropper_jax.statics import nodal_loads
from dropper_jax.study.tide import tidal_cycle

DATA = resources.files("dropper_jax") / "data"
#: Lifted node of each scenario of the lab experiment.
LIFTED = {"A": 1, "B": 2, "C": 3}
#: Nominal diameter [m] of the backbone in the paper's Table 1.
NOMINAL = 0.068
LINES = ("ground", "leg", "backbone", "sock")
Row = tuple[str, str, str, str]


def thesis() -> Iterator[Row]:
    """(table, number there, number here, why) of the thesis."""
    yield from pendulums()
    yield from lab_dropper()
    yield from release_angles()
    yield (
        "8.3, 8.4 pairs of damping coefficients",
        "(0.010, 0), (0.010, 0.001), (0.010, 0.030); (0.001, 0.001), (0.002, 0.001), (0.001, 0.002)",
        "the same, in `source_figures.py thesis-8.14` to `thesis-8.27`",
        "the measured trace is not published, so the best pair cannot be checked. A fit by gradients finds a "
        "pair with errors from one trace ([sweeps](sweeps-and-sensitivity.md))",
    )
    yield from north_sea()
    masses = {"A": 19.5, "B": 18.6}
    far = 6.2 + 7.65
    lengths = {kind: (75.0 * m + 150.0 * far) / (m + far) / 1e3 for kind, m in masses.items()}
    yield (
        "D.1 equivalent pendulums, by (D.3)-(D.7)",
        "m_A 0.0334, m_B 0.0324 kg; L_A 0.1061, L_B 0.1040 m",
        f"m_A {(19.5 + far) / 1e3:.4f}, m_B {(18.6 + far) / 1e3:.4f} kg; "
        f"L_A {lengths['A']:.4f}, L_B {lengths['B']:.4f} m",
        "L_B does not follow from the table. The packaged scenes have the printed 0.1040 m. I_A and I_B are second "
        "moments of area [mm^4], which times a density are not moments of inertia",
    )
    yield (
        "E.1 pairs for sweeps",
        "15 pairs",
        "the same 15 (`benchmarks/sweep_truths.py`)",
        "it has neither (0.010, 0) nor any pair of Table 8.4",
    )


def pendulums() -> Iterator[Row]:
    """Tables 2.1, 3.1, 3.2."""
    circle = float(dj.load_scene("conical-pendulum").start.azimuth_rate[0])
    printed = dj.simulate(dj.load_scene("conical-pendulum").with_values({"start.azimuth_rate": [3.0105]}))
    polar = printed.polar[:, 0]
    yield (
        "2.1 conical pendulum, 1 m, pi/8 below the horizontal",
        "rate of a circle 3.0105 rad/s",
        f"{circle:.4f} rad/s",
        "the printed rate is sqrt(g cos(pi/8) / L), that of an angle from the vertical. With it the polar angle goes "
        f"from {np.min(polar):.3f} to {np.max(polar):.3f} rad: no circle, and not by non-linearity",
    )
    for table, name in (("3.1", "double-pendulum-periodic"), ("3.2", "double-pendulum-chaotic")):
        run = dj.simulate(name)
        yield (
            f"{table} double pendulum, `{name}`",
            "50 s at 3.33e-5 s",
            f"50 s at {run.scene.run.dt:g} s, {run.status}, energy error {run.energy_drift / run.energy_scale:.0e}",
            "without numbers; Figures 3.3 to 3.6 are drawn",
        )


def lab_dropper() -> Iterator[Row]:
    """Table 8.1."""
    line = dj.load_scene("dropper-release-a").lines[0]
    yield (
        "8.1 lab dropper, total mass M",
        "0.2621 kg (E_max = 2.5624 N: 0.2612 kg)",
        f"{float(np.sum(line.mass)):.4f} kg",
        "3 links A and 4 B of the same table; 4 A and 3 B have 0.2308 kg. M is not the sum of its links",
    )
    yield (
        "8.1 total length L",
        "0.7346 m",
        f"{float(np.sum(line.length)):.4f} m",
        "3 links A and 4 B; 4 A and 3 B have 0.7364 m. The text says 4 A, (8.1) says 4 B",
    )


def release_angles() -> Iterator[Row]:
    """Tables 8.2 and E.2 to E.4, from the angles of runs and model that are printed."""
    for (scenario, angles), table in zip(measured().items(), ("8.2, E.2", "E.3", "E.4"), strict=True):
        pose = dj.equilibrium(f"dropper-release-{scenario.lower()}")
        link = np.diff(pose.positions, axis=0)
        angle = np.arctan2(-link[:, 2], link[:, 0])
        off = [rms(angle - angles[which]) for which in ("mean", "model")]
        yield (
            f"{table} release angles of scenario {scenario}",
            f"model off the mean run by {rms(angles['model'] - angles['mean']):.4f} rad (RMS of 7 links)",
            f"pose here off the mean run by {off[0]:.4f} rad, off the model by {off[1]:.4f} rad",
            "the packaged force at the lifted node is fitted to the measured pose; for (E.1) to (E.3) see "
            "[the thesis' releases](checked-against.md#the-thesis-releases)",
        )


def north_sea() -> Iterator[Row]:
    """Table 8.5 and appendix G."""
    scene = dj.load_scene("dropper-north-sea-thesis")
    line = scene.lines[0]
    waves = scene.sea.waves
    yield (
        "8.5 dropper in the North Sea",
        "L 17 m, M 238 kg, N = 18 (the text: 17 pendulums), 14 kg/m, D 0.05 m",
        f"L {float(np.sum(line.length)):.0f} m, M {float(np.sum(line.mass)):.0f} kg, {line.links} links, "
        f"{float(np.sum(line.mass) / np.sum(line.length)):.0f} kg/m, D {float(np.max(line.diameter)):g} m",
        "the same. 14 kg/m of 0.05 m are 7130 kg/m3: buoyancy is left out there, and named in the scenes here. Results "
        "in [water](water.md#the-thesis-forces)",
    )
    height = 4.0 * np.sqrt(0.5 * np.sum(np.square(waves.amplitude)))
    yield (
        "G waves",
        "190 components in the text, Hs 8.20 m",
        f"{len(waves.amplitude)} components, Hs {height:.2f} m",
        "the tables as printed have these; the stated sea is `north-sea-25-year-jonswap`",
    )


def paper() -> Iterator[Row]:
    """(table, number there, number here, why) of the paper."""
    edulis = dj.load_scene("edulis-longline")
    case = dj.load_scene("paper-case-1")
    length = {n: sum(float(np.sum(x.length)) for x in edulis.lines if n in x.name) for n in LINES}
    yield (
        "1 lines of Edulis",
        "chain 108 m of 10.91 kg/m, backbone 57 m of 2.1 kg/m, sock 145 m of 21.8 kg/m",
        f"chain {length['ground'] + length['leg']:.0f} m, backbone {length['backbone']:.0f} m, "
        f"sock {length['sock']:.0f} m, the same masses",
        "145 m is the total of all socks",
    )
    buoy = edulis.buoys[0]
    volume = 0.25 * np.pi * float(buoy.diameter) ** 2 * float(buoy.height)
    yield ("2 spar buoys of Edulis", "2500 kg, 4.345 m3", f"{float(buoy.mass):.0f} kg, {volume:.3f} m3", "")
    yield (
        "3 anchors of Edulis",
        "2 gravity of 15 t, 2 Danforth of 2.5 t",
        "the same, in line on each side",
        "their arrangement, holding power and material are missing there: assumed "
        "([longlines](longlines.md#currents-along-and-across))",
    )
    chain = case.lines[0]
    yield (
        "4 chain of the cases",
        "0.042 m, 10.910 kg/m, EA 48 884 kN, 50 m, Can 1.0, Cat 0.5, Cdn 1.4, Cdt 0.2",
        f"{float(np.max(chain.diameter)):g} m, {float(np.sum(chain.mass) / np.sum(chain.length)):.3f} kg/m, "
        f"{float(np.sum(chain.length)):.0f} m, the same coefficients",
        "cells run together in the text",
    )
    yield (
        "5 buoy of the cases",
        "1200 kg, 4.345 m3, Can 0.94, Cat 0.50, Cdn 0.81, Cdt 0.40",
        f"{float(case.buoys[0].mass):.0f} kg, the same",
        "Table 2 has 2500 kg. Cat 0.50 is of a hemisphere (66 kg); on the wetted volume it would be 793 kg",
    )
    start = dj.load_scene("paper-case-1-table-6").value("point.buoy.position")
    yield ("6 start", "buoy at (30, 0, -4.43) m", f"{tuple(float(x) for x in start)} m", "")
    steady = dj.equilibrium("paper-case-4")
    yield (
        "7 case 4, steady anchor tension",
        "largest 1558 N (OrcaFlex), 1535 N (adapted MoorDyn)",
        f"{float(steady.tension[0]):.1f} N at rest",
        "means and extremes of all cases: [MoorDyn](checked-against.md#the-papers-table-7)",
    )
    waves = dj.load_scene("paper-case-3").sea.waves
    height = 4.0 * np.sqrt(0.5 * np.sum(np.square(waves.amplitude)))
    yield (
        "A1 irregular sea",
        "29 components",
        f"{len(waves.amplitude)} components, Hs {height:.2f} m",
        "periods are used: the rounded frequencies drift by 0.16 rad in 100 s, weighted by energy, and 0.31 rad at "
        "most",
    )
    yield (
        "(20)-(21) OrcaFlex's tension with inner and outer pressure and Poisson's ratio",
        "effective and wall tension",
        "not modelled",
        "they are OrcaFlex's, for pipes. Chain and rope have no inside, and buoyancy acts as a force on the nodes: the "
        "tension here is the effective one, and EA the measured stiffness under it",
    )
    yield (
        "wakes in a tide",
        "not modelled",
        "an error if the current turns",
        "wakes are computed for one direction of the current when the scene is built",
    )


def nominal_diameters() -> Row:
    """What one diameter for volume and drag changes: Edulis' tide along and across with the drag of the nominal one."""
    line = next(x for x in dj.load_scene("edulis-longline").lines if x.name.startswith("backbone"))
    size = float(np.max(line.diameter))
    weight = float(line.mass[0] / line.length[0])
    cdn = dj.load_scene("edulis-tide").value("line_type.backbone.cdn")
    changes = []
    for heading in (0.0, 0.5 * np.pi):
        tide = dj.load_scene("edulis-tide").with_values({"sea.current.direction": heading})
        loads = []
        for scene in (tide, tide.with_values({"line_type.backbone.cdn": cdn * NOMINAL / size})):
            held = [row["held_load_n"] for row in tidal_cycle(scene, 5)["rows"]]
            loads.append(max(float(np.linalg.norm(load)) for one in held for load in one.values()))
        changes.append(100 * (loads[1] / loads[0] - 1))
    return (
        "1 nominal diameters",
        f"chain 0.022 m, backbone {NOMINAL:g} m, sock 0.15 m",
        f"displacement diameters, of the backbone {size:.4f} m",
        f"a solid backbone of its nominal diameter would float ({weight / (0.25 * np.pi * NOMINAL**2):.0f} kg/m3). One "
        f"diameter serves volume and drag: the backbone has {100 * (1 - size / NOMINAL):.0f} % less drag area than on "
        f"{NOMINAL:g} m. `line_type.backbone.cdn={cdn * NOMINAL / size:.2f}` makes up for it: the largest anchor load "
        f"in the tide changes by {changes[0]:.1f} % along and {changes[1]:.1f} % across the backbone",
    )


def figures() -> Iterator[Row]:
    """(figure, caption, scenes, note) of every one that `source_figures.py` draws."""
    rows = tomllib.loads(TABLE.read_text(encoding="utf-8"))["figure"]
    for row in rows:
        note = f"missing there, chosen: {row['note']}" if row.get("note") else ""
        yield (row["name"], row["caption"], ", ".join(f"`{name}`" for name in row["scenes"]), note)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def measured() -> dict[str, dict[str, np.ndarray]]:
    """Mean of the runs and the thesis' model column, by scenario, theta > 0 for a link that goes down as x grows."""
    rows: dict[str, dict[str, np.ndarray]] = {}
    for row in csv.DictReader((DATA / "release_angles_rad.csv").read_text().splitlines()):
        sign = 1.0 if row["scenario"] == "A" else -1.0  # B and C are printed with the opposite sign
        angles = sign * np.array([float(row[f"theta_{i}"]) for i in range(1, 8)])
        rows.setdefault(row["scenario"], {})[row["column"]] = angles
    return {
        scenario: {"mean": np.mean([v for k, v in columns.items() if k.startswith("run")], axis=0), **columns}
        for scenario, columns in rows.items()
    }


def lab_models() -> dict[str, dj.Model]:
    """The lab dropper by kinds of its links."""
    scene = dj.load_scene("dropper-release-a")
    line = scene.lines[0]
    order = [1, 0] * 3 + [1]
    swapped = {"line.0.length": line.length[order], "line.0.mass": line.mass[order]}
    scenes = {
        "simple links, A first": scene.with_values(swapped),
        "simple links, B first": scene,
        "compound bars": "dropper-release-a-compound",
    }
    return {kind: dj.build(scene)[0] for kind, scene in scenes.items()}


def planar_angles(model: dj.Model, r: jax.Array) -> jax.Array:
    """Angles of the links below the horizontal (n,) [rad] in the x-z plane."""
    d = model.links(r, model.ends(jnp.zeros(())))
    return jnp.arctan2(-d[:, 2], d[:, 0])


def misfit(model: dj.Model, node: int, target: np.ndarray) -> float:
    """RMS misfit [rad] to the target angles of the nearest pose under a force (fx, fz) [N] at `node`.

    The Jacobian is exact (the pose's derivative by the implicit function theorem). A direction of the force that
    turns nothing is left where it is.
    """

    def pose(force: np.ndarray) -> dj.State:
        return dj.equilibrium(model, nodal_loads(model, [node], [[force[0], 0.0, force[1]]])).state

    @jax.jit
    def slope(force: jax.Array, near: dj.State) -> jax.Array:
        def angles(f: jax.Array) -> jax.Array:
            loads = jnp.zeros((model.free_nodes, 3)).at[node - 1].set(jnp.array([f[0], 0.0, f[1]]))
            return planar_angles(model, dj.settle(model, near, loads).r)

        return jax.jacfwd(angles)(force)

    found = least_squares(
        lambda force: np.asarray(planar_angles(model, pose(force).r)) - target,
        np.array([0.0, 0.9]),
        jac=lambda force: np.asarray(slope(jnp.asarray(force), pose(force))),
        x_scale=0.1,
        xtol=1e-12,
        ftol=1e-12,
    )
    return rms(found.fun)


@command(poses=False)
def main(args) -> None:
    if args.poses:
        show("links", *LIFTED, "thesis' model column of A")
        targets = measured()
        cases = [*((node, targets[scenario]["mean"]) for scenario, node in LIFTED.items()), (1, targets["A"]["model"])]
        for kind, model in lab_models().items():
            show(kind, *(f"{misfit(model, node, target):.4f}" for node, target in cases))
        return
    found = {
        "schema": 1,
        "thesis": list(thesis()),
        "paper": [*paper(), nominal_diameters()],
        "figures": list(figures()),
    }
    store("sources", found)
