"""Damaged files given to the readers of this process: `worker.py FOLDER SEED COUNT [KIND...]`, a JSON line per fault.

Apart from the tests, since HDF5 and codecs may bring the process down. Before each case its number goes to standard
error, so that the last one is known.
"""

import contextlib
import io
import json
import random
import shutil
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mutations import ARCHIVE, BYTES, TEXT

import dropper_jax as dj
from dropper_jax import SceneError, as_toml, packaged_scene
from dropper_jax.cli import main
from dropper_jax.run.summary import write_angles
from dropper_jax.sea.wave_files import read_components, read_elevation
from fitting import read_data, read_trace
from fitting.sweep import open_sweep

#: Seconds after which a case hangs.
HANGS = 60
SCENES = ("edulis-longline", "dropper-farm", "dropper-regular-wave", "paper-case-4", "ballasted-spar", "string")
SCENES += ("dropper-release-a-compound", "platform-longline", "dropper-north-sea", "paper-case-2-pitching")
CHANNELS = """
[[run]]
file = "run.csv"
from = 0.0
[[channel]]
name = "top"
kind = "tension"
column = "load"
unit = "kN"
link = 1
noise = 1.0
noise_unit = "%"
[[camera]]
name = "left"
position = [0.0, -5.0, -0.5]
look_at = [0.0, 0.0, -0.5]
focal = 1500.0
centre = [960.0, 540.0]
"""


class Hanging(BaseException):
    """A case that takes too long."""


class Kinds:
    """What is damaged and who reads it, by kind."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.decks = Path(__file__).parents[1] / "moordyn"
        run = dj.simulate("double-pendulum-chaotic", duration=0.1, dt=0.01)
        for suffix in ("npz", "nc", "zarr"):
            run.save(folder / f"good.{suffix}")
        write_angles(run, folder / "good.csv")
        (folder / "run.csv").write_text("t,load\n" + "".join(f"{0.01 * i},{1 + 0.1 * i}\n" for i in range(30)))
        (folder / "data.toml").write_text(CHANNELS)
        rows = "".join(f"{5 + i},{0.1 * i + 0.1},{0.3 * i}\n" for i in range(5))
        (folder / "components.csv").write_text("period_s,amplitude_m,phase_rad\n" + rows)
        (folder / "elevation.csv").write_text("t_s,elevation_m\n" + "".join(f"{0.5 * i},{i % 5}\n" for i in range(40)))
        for name in SCENES:
            (folder / f"{name}.toml").write_text(as_toml(packaged_scene(name)))
        beside = [*self.decks.glob("*.txt"), *(f for f in (self.decks / "decks").iterdir() if f.suffix != ".json")]
        for deck in beside:
            shutil.copy(deck, folder / deck.name)
        self.read = [deck.name for deck in beside if deck.suffix != ".bath" and deck.name != "rope_table.dat"]
        self.scene = dj.load_scene("double-pendulum-chaotic")
        self.reported = self.command("report", folder / "good.npz")
        self.sweep = ["sweep", "conical-pendulum", "--vary", "line.0.mass=1:2:3", "--duration", "0.05", "--chunk", "2"]
        self.sweep += ["--devices", "1", "--quiet"]
        self.swept = self.command(*self.sweep, "--out", folder / "good-sweep.zarr")

    def command(self, *words: Any) -> dict[str, Any] | None:
        """The JSON object of a command that ends well, None of one that refuses."""
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([*map(str, words), "--json"])
        lines = out.getvalue().splitlines()
        assert len(lines) == 1, f"{len(lines)} lines on standard output"
        found = json.loads(lines[0], parse_constant=lambda text: pytest_fail(f"{text} in JSON"))
        assert found["status"] != "internal_error", found["error"]
        assert "Traceback" not in err.getvalue(), err.getvalue()[-600:]
        assert code in (0, 2, 3), f"exit code {code}"
        if code:
            errors = [line for line in err.getvalue().splitlines() if line.startswith("error: ")]
            assert len(errors) == 1, f"{len(errors)} lines of errors: {err.getvalue()[-600:]}"
        return found if code == 0 else None

    def _damaged(self, name: str, ways: list[Any], rng: random.Random) -> Path:
        path = self.folder / f"bad{Path(name).suffix}"
        path.write_bytes(rng.choice(ways)((self.folder / name).read_bytes(), rng))
        return path

    def _npz(self, rng: random.Random, name: str = "good.npz", ways: list[Any] = ARCHIVE) -> None:
        compare(self.reported, self.command("report", self._damaged(name, ways, rng)))

    def _nc(self, rng: random.Random) -> None:
        self._npz(rng, "good.nc", BYTES)

    def _folder(self, good: str, rng: random.Random) -> Path:
        """A copy of a folder with one of its files damaged or gone."""
        bad = self.folder / "bad.zarr"
        shutil.rmtree(bad, ignore_errors=True)
        shutil.copytree(self.folder / good, bad)
        file = rng.choice(sorted(f for f in bad.rglob("*") if f.is_file()))
        data = file.read_bytes()
        if rng.random() < 0.1 or not data:
            file.unlink()
        else:
            file.write_bytes(rng.choice(TEXT if b'"' in data else BYTES)(data, rng))
        return bad

    def _zarr(self, rng: random.Random) -> None:
        compare(self.reported, self.command("report", self._folder("good.zarr", rng)))

    def _store(self, rng: random.Random) -> None:
        bad = self._folder("good-sweep.zarr", rng)
        self.command(*self.sweep, "--out", bad)
        with contextlib.suppress(SceneError):
            open_sweep(bad)

    def _toml(self, rng: random.Random) -> None:
        found = self.command("scenes", self._damaged(f"{rng.choice(SCENES)}.toml", TEXT, rng), "--expanded")
        no_holes(found)

    def _deck(self, rng: random.Random) -> None:
        name = rng.choice(sorted(set(self.read)))
        path = self._damaged(name, TEXT, rng)
        if name.startswith("current_profile"):  # a deck reads it
            shutil.copy(path, self.folder / name)
            path = self.folder / "current.txt"
        no_holes(self.command("scenes", path, "--expanded"))
        shutil.copy(self.decks / name if (self.decks / name).exists() else self.decks / "decks" / name, self.folder)

    def _csv(self, rng: random.Random) -> None:
        readers = {
            "good.csv": lambda path: read_trace(path, links=2),
            "components.csv": read_components,
            "elevation.csv": read_elevation,
        }
        name = rng.choice(list(readers))
        with refusals():
            readers[name](self._damaged(name, TEXT, rng))

    def _channels(self, rng: random.Random) -> None:
        with refusals():
            if rng.random() < 0.7:
                read_data(self._damaged("data.toml", TEXT, rng), self.scene)
            else:
                text = CHANNELS.replace("run.csv", self._damaged("run.csv", TEXT, rng).name)
                (self.folder / "other.toml").write_text(text)
                read_data(self.folder / "other.toml", self.scene)

    def _video(self, rng: random.Random) -> None:
        good = self.folder / "good.avi"
        if not good.exists():
            _film(good)
        self.command("track", self._damaged("good.avi", BYTES, rng), "--nodes", 3, "--quiet")


def _film(path: Path) -> None:
    import cv2
    import numpy as np

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (160, 120))
    for i in range(12):
        image = np.full((120, 160, 3), 255, np.uint8)
        for j in range(3):
            cv2.circle(image, (40 + 30 * j + i, 30 + 25 * j), 7, (0, 0, 0), 2)
        writer.write(image)
    writer.release()


def pytest_fail(text: str) -> None:
    raise AssertionError(text)


@contextlib.contextmanager
def refusals() -> Iterator[None]:
    """What readers refuse is one line."""
    try:
        yield
    except SceneError as error:
        text = str(error)
    else:
        return
    assert len(text.splitlines()) == 1, f"several lines, or none: {text}"


def compare(good: Any, found: Any, path: str = "") -> None:
    """No number of the undamaged file's report is missing from one that says that all is well."""
    if found is None or good is None:
        return
    if isinstance(good, dict) and isinstance(found, dict):
        for key in good.keys() & found.keys():
            compare(good[key], found[key], f"{path}.{key}")
    elif isinstance(good, list) and isinstance(found, list):
        for i, (a, b) in enumerate(zip(good, found, strict=False)):
            compare(a, b, f"{path}.{i}")
    elif isinstance(good, float | int):
        assert found is not None, f"{path} silently became nothing"


def no_holes(found: Any, path: str = "") -> None:
    """A scene leaves out what it has not: a null was a number that is none."""
    for key, value in found.items() if isinstance(found, dict) else enumerate(found) if isinstance(found, list) else ():
        assert value is not None, f"{path}.{key} is silently not finite"
        no_holes(value, f"{path}.{key}")


KINDS = ("npz", "toml", "csv", "nc", "deck", "zarr", "channels", "toml", "npz", "deck", "store", "video")


def _alarm(*_: Any) -> None:
    raise Hanging


def work(folder: Path, seed: int, count: int, kinds: tuple[str, ...]) -> None:
    warnings.simplefilter("ignore")
    cases = Kinds(folder)
    signal.signal(signal.SIGALRM, _alarm)
    for number in range(count):
        kind = kinds[number % len(kinds)]
        print(f"{kind} {seed} {number}", file=sys.stderr, flush=True)
        signal.alarm(HANGS)
        try:
            getattr(cases, f"_{kind}")(random.Random(f"{seed} {number}"))
        except (Exception, Hanging) as error:
            text = f"{type(error).__name__}: {error}"
            print(json.dumps({"kind": kind, "seed": seed, "case": number, "fault": text[:600]}), flush=True)
        finally:
            signal.alarm(0)
    print(json.dumps({"done": count}), flush=True)


if __name__ == "__main__":
    work(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), tuple(sys.argv[4:]) or KINDS)
