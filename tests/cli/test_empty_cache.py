"""Every command by an example: without stored programs, as on a new machine, and with those that it stored."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import entry_points

import pytest

#: The shortest example of each command, in a folder with the files of `workshop`.
EXAMPLES = {
    "accuracy": "dropper-release-a --quick --integrators theta:0.51 theta_midpoint --dts 0.02 0.01 --span 0.2",
    "cases": "small-longline --list",
    "check": "dropper-release-a",
    "cost": "double-pendulum-chaotic",
    "demo": "--out demo",
    "design": "paper-case-4 --vary line.chain.length=51:52 --target tension.chain.last --value 3730",
    "doctor": "--repeats 2",
    "equilibrium": "dropper-release-a",
    "explain": "platform-longline",
    "fit": "trace.csv --scene dropper-release-a --free b_l --method windows --until 1.0",
    "frequency": "wet-pendulum-wave --sea-states 0.1:3 --frequencies 4",
    "growth": "mussels.toml --months 6",
    "library": "",
    "modes": "dropper-release-a --count 2",
    "new": "longline longline.toml",
    "offset": "platform-longline --points platform --direction 0 --distance 0:1:0.5",
    "optimise": "small-longline --check",
    "plan": "dropper-release-a --free b_l --duration 1",
    "report": "run.npz --report report",
    "response": "wet-pendulum-wave --periods 3:3:1 --no-higher-waves",
    "run": "double-pendulum-chaotic --duration 0.2",
    "scenes": "",
    "sea": "wet-pendulum-wave",
    "season": "exposed-bay",
    "sensitivity": "dropper-release-a --duration 0.1 --of tension.max --to b_l",
    "stability": "--cases dry-friction-two-joints gradient-dry-friction",
    "stiffness": "paper-case-4",
    "sweep": "dropper-release-a --vary b_l=0.001:0.01:2 --duration 0.1 --out sweep.zarr",
    "track": "film.avi --nodes 8 --out traces.csv",
    "view": "run.npz --out view.html",
}


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """Films, traces and runs that commands read."""
    import dropper_jax as dj
    from dropper_jax.cli.new import template
    from fitting import Camera, View, film, observe, simulate_truth, write_trace, write_video

    folder = tmp_path_factory.mktemp("workshop")
    lab = dj.load_scene("dropper-release-a")
    camera = Camera(rate=60.0, angle_noise=0.005)
    write_trace(folder / "trace.csv", observe(simulate_truth(lab, 1.5, 60.0), camera, seed=0))
    (folder / "mussels.toml").write_text(template("mussels"))
    run = dj.simulate("conical-pendulum", duration=0.5, dt=1 / 60)
    run.save(folder / "run.npz")
    write_video(folder / "film.avi", film(simulate_truth(lab, 1.0, 60.0), View(noise=4.0), fps=60.0), 60.0)
    return folder


def test_every_command_has_an_example():
    assert sorted(entry.name for entry in entry_points(group="dropper.commands")) == sorted(EXAMPLES)


@pytest.mark.check
@pytest.mark.parametrize("command", EXAMPLES)
def test_the_command_ends_well_without_stored_programs_and_with_those_that_it_has_stored(command, workshop, tmp_path):
    environment = {key: x for key, x in os.environ.items() if not key.startswith(("DROPPER_", "XLA_FLAGS"))}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONDEVMODE": "1"}
    call = [sys.executable, "-m", "dropper_jax", command, *EXAMPLES[command].split()]
    for start in ("first", "second"):
        folder = shutil.copytree(workshop, tmp_path / start)
        done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{start} start: {done.stdout[-1000:]}\n{done.stderr[-2000:]}"
