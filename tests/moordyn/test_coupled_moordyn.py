"""Coupling beside MoorDyn: the same chain, its fairlead driven by the same motion."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj

moordyn = pytest.importorskip("moordyn")
DECK = Path(__file__).parent / "chain.txt"
HOME, RAMP, PERIOD = np.array([0.0, 0.0, -5.0]), 4.0, 10.0
#: Steps of the coupling: MoorDyn moves points straight through each, and every change of speed rings in the chain.
FINE, COARSE, END = 0.005, 0.05, 12.0


def motion(t):
    """Place [m] and velocity [m/s] of a fairlead that begins to move smoothly."""
    u, w = np.clip(t / RAMP, 0.0, 1.0), 2 * np.pi / PERIOD
    ramp, rate = u**3 * (10 - 15 * u + 6 * u * u), 30 * (u * (1 - u)) ** 2 / RAMP
    size, phase = np.array([1.5, 0.3, 0.5]), w * t + np.array([0.0, 1.0, 2.0])
    return HOME + size * ramp * np.sin(phase), size * (rate * np.sin(phase) + ramp * w * np.cos(phase))


def theirs(folder):
    shutil.copy(DECK, folder / "chain.txt")
    system = moordyn.Create(str(folder / "chain.txt"))
    moordyn.Init(system, HOME.tolist(), [0.0] * 3)
    steps, found = round(COARSE / FINE), []
    for i in range(round(END / FINE)):
        place, rate = motion(i * FINE)  # MoorDyn goes on from the beginning of a step
        force = moordyn.Step(system, place.tolist(), rate.tolist(), i * FINE, FINE)
        if i % steps == steps - 1:
            found.append(force)
    moordyn.Close(system)
    return np.array(found)


@pytest.mark.check
def test_forces_of_a_driven_chain_are_those_of_moordyn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    coupled = dj.Coupled(DECK, points=["fairlead"], dt=0.01)
    at_rest = coupled.init()[0]
    other = theirs(tmp_path)
    ours = np.array([coupled.step(*motion((i + 1) * COARSE), COARSE)[0] for i in range(len(other))])
    assert np.abs(at_rest - other[0]).max() < 0.01 * np.linalg.norm(at_rest)
    difference = np.linalg.norm(ours - other, axis=1) / np.linalg.norm(other, axis=1)
    assert np.ptp(np.linalg.norm(other, axis=1)) > 0.15 * np.linalg.norm(at_rest)  # it is driven
    assert difference.max() < 0.04
    assert np.sqrt(np.mean(difference**2)) < 0.01


@pytest.mark.check
def test_anchor_of_a_chain_on_the_bed_feels_the_friction_law_of_moordyn(tmp_path, monkeypatch):
    # MoorDyn's friction holds a node at rest by nothing: the anchor feels the fairlead; Coulomb's hides much of it
    monkeypatch.chdir(tmp_path)
    options = "1e5 kbot\n1e4 cbot\n0.5 FrictionCoefficient\n2000 FricDamp\n50            WtrDpth"
    text = DECK.read_text().replace("-80.0   0", "-140.0  0").replace("100       20", "155 31")
    text = "\n".join(line for line in text.splitlines() if "kbot" not in line and "cbot" not in line)
    file = tmp_path / "bed.txt"
    file.write_text(text.replace("50            WtrDpth", options).replace("0.002 ", "0.0005"))
    system, h, span = moordyn.Create(str(file)), 0.0005, 24.0
    moordyn.Init(system, HOME.tolist(), [0.0] * 3)
    line, other = moordyn.GetLine(system, 1), []
    for i in range(round(span / h)):
        place, rate = motion(i * h)
        moordyn.Step(system, place.tolist(), rate.tolist(), i * h, h)
        if i % 100 == 99:
            other.append([np.linalg.norm(moordyn.GetLineNodeTen(line, end)) for end in (0, moordyn.GetLineN(line))])
    moordyn.Close(system)
    t = np.linspace(0.0, span, 481)
    table = dj.load_scene(file).to_dict()
    moved = [(motion(one)[0] - HOME).tolist() for one in t]
    table["effects"]["end_motion"] = {"point": "fairlead", "time": t.tolist(), "displacement": moved}
    table["run"] = {"dt": 0.01, "duration": span, "save_every": 5}
    late = t[1:] > 6.0
    theirs = np.array(other)[late]
    found = {}
    for law in ("moordyn", "coulomb"):
        scene = dj.load_scene(table).with_values({"effects.seabed_friction.law": law})
        run = dj.simulate(scene)
        assert run.status == "ok"
        found[law] = run.tension[1:, [0, -1]][late]
    for end in (0, 1):
        assert found["moordyn"][:, end].std() == pytest.approx(theirs[:, end].std(), rel=0.03)
        assert found["moordyn"][:, end].max() == pytest.approx(theirs[:, end].max(), rel=0.03)
    assert found["coulomb"][:, 0].std() < 0.5 * theirs[:, 0].std()


@pytest.mark.check
def test_deviation_of_a_driven_jumper_is_moordyns_where_it_is_called_at_every_step(tmp_path, monkeypatch):
    # a jumper with EI (Lowe and Langley 2006), hanging free: calls every 0.01 s took 5 % of MoorDyn's deviation
    monkeypatch.chdir(tmp_path)
    text = DECK.read_text().replace("-80.0   0    -50.0", "-100.0  0    -55.0").replace("100       20", "170 34")
    text = text.replace("Chain      0.1     30.0      1e8    -0.8         0          1.6     1     0.1     0.5", "{}")
    text = text.format("Chain 0.396 165.0 5e8 -0.5 120.8e3 1.0 1.0 0.0 0.0").replace(
        "50            WtrDpth", "100 WtrDpth"
    )
    file = tmp_path / "jumper.txt"
    file.write_text(text.replace("0.002 ", "0.001 ").replace("1             ICgenDynamic", ""))
    h, span, late = 0.001, 24.0, slice(240, None)

    def theirs(every):
        system, found = moordyn.Create(str(file)), []
        moordyn.Init(system, HOME.tolist(), [0.0] * 3)
        line, call = moordyn.GetLine(system, 1), every * h
        for i in range(round(span / call)):
            place = motion(i * call)[0]
            speed = (motion((i + 1) * call)[0] - place) / call
            moordyn.Step(system, place.tolist(), speed.tolist(), i * call, call)
            if (i + 1) % (50 // every) == 0:
                found.append(np.linalg.norm(moordyn.GetLineNodeTen(line, moordyn.GetLineN(line))))
        moordyn.Close(system)
        return np.array(found)[late].std()

    t = np.linspace(0.0, span, 481)
    table = dj.load_scene(file).to_dict()
    moved = [(motion(one)[0] - HOME).tolist() for one in t]
    table["effects"]["end_motion"] = {"point": "fairlead", "time": t.tolist(), "displacement": moved}
    table["run"] = {"dt": 0.01, "duration": span, "save_every": 5}
    ours = dj.simulate(table).tension[1:, -1][late].std()
    each, coarse = theirs(1), theirs(10)
    assert ours == pytest.approx(each, rel=5e-3)
    assert coarse < 0.98 * each
