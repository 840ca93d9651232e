"""The same scene in MoorDyn v2 and here: runs that give end tensions and the place of the far end at equal times."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from study import Found, timed

from dropper_jax import Model, Scene, State, load_scene, write_moordyn
from dropper_jax.modelling.build import build, stepper_of
from dropper_jax.residual import Stepper
from dropper_jax.sea.make import make_sea
from dropper_jax.stepping.adaptive import follow_and_save
from dropper_jax.stepping.halving import advance_over
from dropper_jax.stepping.progress import begin

#: Time between rows [s], in both codes.
SAMPLE = 0.1
#: Time between the tables of a wave grid [s], and its least and largest y [m] around a single line.
GRID_STEP = 0.1
GRID = (-60, 60)
#: Positions beyond this distance [m] are not possible in the compared scenes: such a run is unstable.
FARTHEST = 1e4
#: MoorDyn's step [s] for each internal damping ratio: stronger dampers need smaller ones.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}

#: The paper's Table 7: anchor tension [N], least, mean and largest, of OrcaFlex and of its adapted MoorDyn.
TABLE_7 = {
    "1": {"orcaflex": (0, 2986, 79442), "adapted_moordyn": (0, 2355, 16597)},
    "2": {"orcaflex": (0, 2696, 68756), "adapted_moordyn": (0, 2609, 12672)},
    "3": {"orcaflex": (0, 1605, 58753), "adapted_moordyn": (0, 293, 14024)},
    "4": {"orcaflex": (0, 1406, 1558), "adapted_moordyn": (0, 1380, 1535)},
    "5": {"orcaflex": (0, 5058, 71766), "adapted_moordyn": (0, 3319, 24173)},
}


def case(number: int, ratio: float = 0.1) -> Scene:
    """A case of the paper, from its positions. Cases 3 and 5 are turned by 90 degrees, so that waves travel in +x."""
    values = {"line_type.chain.damping_ratio": ratio}
    if number in (3, 5):
        values.update({"point.buoy.position": [0.0, 30.0, -4.43], "sea.waves.direction": 0.0})
    if number == 5:
        values["sea.current.direction"] = 0.0
    return load_scene(f"paper-case-{number}-table-6").with_values(values)


@dataclass
class Rows:
    """A run: times (k,), and per row the mean, least and largest tension at both ends (k, 2) and the far end's place.

    Attributes:
        square: mean square of the tensions.
        cpu_s: processor time of the run without compilation or file reading. Both codes run on one thread.
        retried: steps taken again, as a share.
        status: `ok` or what went wrong.
        sizes: of MoorDyn, mean, least and largest size of the end tensions (k, 3, 2), pushing counted as pulling.
    """

    t: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    least: np.ndarray
    most: np.ndarray
    place: np.ndarray
    cpu_s: float
    status: str
    retried: float = 0.0
    sizes: np.ndarray | None = None

    def peaks(self, start: float, window: float) -> float:
        """Mean of the largest fairlead tensions [N] in windows of `window` [s] from `start` on."""
        most = self.most[self.t > start + 0.5 * SAMPLE, 1]
        each = round(window / SAMPLE)
        return float(np.mean(most[: len(most) // each * each].reshape(-1, each).max(axis=1)))

    def statistics(self, start: float = 0.0) -> Found:
        """Tension of anchor and fairlead [N] and ranges of the far end [m], from `start` on.

        `std` is that of all steps (or looks), `std_of_rows` that of the means over SAMPLE: below 5 Hz.
        """
        found: Found = {"status": self.status, "retried": self.retried}
        if self.status != "ok":
            return found
        kept = self.t > start
        for i, name in enumerate(("anchor", "fairlead")):
            mean = float(np.mean(self.mean[kept, i]))
            square = float(np.mean(self.square[kept, i]))
            found[name] = {
                "min": float(np.min(self.least[kept, i])),
                "mean": mean,
                "std": float(np.sqrt(max(square - mean**2, 0.0))),
                "max": float(np.max(self.most[kept, i])),
                "std_of_rows": float(np.std(self.mean[kept, i])),
            }
            if self.sizes is not None:
                mean, least, most = self.sizes[kept, :, i].T
                found[name]["size"] = {"min": float(least.min()), "mean": float(mean.mean()), "max": float(most.max())}
        place = self.place[kept]
        return {**found, "place": {"min": place.min(axis=0).tolist(), "max": place.max(axis=0).tolist()}}


@partial(jax.jit, static_argnames=("stepper", "saves", "ends"))
def _march(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: jax.Array,
    accuracy: float | None,
    every: jax.Array,
    saves: int,
    ends: tuple[int, int],
):
    """Rows of `every` steps of dt [s] each; with an accuracy the steps follow it and are at most so long.

    Returns:
        How many steps were taken again; of a line, whose first and last link are the `ends`, mean, mean square, least
        and largest tension (saves, 2), its far end's place (saves, 3), and whether all is well (saves,).
    """
    last_link = ends[1]
    ends = jnp.array(ends)

    def link_tensions(model, before, after):
        return after.tension, after.t

    def advance(carry):
        progress, s, alive, again = carry
        taken = advance_over(stepper, model, s, dt, alive)
        tension = taken.state.tension[ends]
        good = alive & ~taken.failed
        return (progress, taken.state, good, again + taken.retried), (tension, tension**2, tension, tension)

    def follow(carry):
        done, row = follow_and_save(stepper, model, carry[0], dt, accuracy, link_tensions)
        between = (row.within.mean, row.within.square, row.extremes.least, row.extremes.largest)
        return (done, done.state, done.first_bad < 0, done.control.refused), tuple(a[ends] for a in between)

    first = begin(stepper, model, s, follows=accuracy is not None)
    if accuracy is not None:
        advance = follow

    def one(_: jax.Array, inner):
        carry, total, square, least, most = inner
        carry, (mean, squares, low, high) = advance(carry)
        return carry, total + mean, square + squares, jnp.minimum(least, low), jnp.maximum(most, high)

    def save(carry, _: None):
        zero = jnp.zeros(2, model.dtype)
        start = (carry, zero, zero, zero + jnp.inf, zero - jnp.inf)
        carry, total, square, least, most = jax.lax.fori_loop(0, every, one, start)
        _, s, alive, _ = carry
        place = model.geometry.everywhere(s.r, model.ends(s.t).positions)[model.geometry.last[last_link]]
        return carry, (total / every, square / every, least, most, place, alive)

    carry = (first, first.state, jnp.array(True), jnp.zeros((), jnp.int32))
    (*_, again), rows = jax.lax.scan(save, carry, None, length=saves)
    return again, rows


@dataclass(frozen=True)
class Ours:
    """A scene here; one program serves all step sizes, and scenes that differ in values only."""

    stepper: Stepper
    model: Model
    start: State
    ends: tuple[int, int]

    @classmethod
    def of(cls, scene: Scene, line: int = 0) -> "Ours":
        model, start = build(scene)
        first = sum(len(before.length) for before in scene.lines[:line])
        ends = first, first + len(scene.lines[line].length) - 1
        return cls(stepper_of(model, scene.run, track_work=False), model, start, ends)

    def run(self, every: int, duration: float, repeats: int = 1, accuracy: float | None = None) -> Rows:
        """Steps of SAMPLE / every [s], or with an accuracy at most so long; the least time counts."""
        saves = round(duration / SAMPLE)
        given = (self.stepper, self.model, self.start, jnp.asarray(SAMPLE / every), accuracy)

        def march(count: int):
            return jax.block_until_ready(_march(*given, jnp.asarray(count), saves=saves, ends=self.ends))

        march(0)  # compiles
        runs = [timed(partial(march, every)) for _ in range(repeats)]
        again, rows = runs[0][0]
        *values, alive = (np.asarray(a) for a in rows)
        t = SAMPLE * np.arange(1, saves + 1)
        if bool(alive[-1]):
            status = "ok"
        else:
            status = f"not_converged at {t[np.argmin(alive)]:.4g} s"
        least = min(times["processor_s"] for _, times in runs)
        return Rows(t, *values, least, status, float(again) / (saves * every))


def _signed(moordyn, line, count: int, last: bool) -> float:
    """Tension [N] of an end segment, negative where the damper of a slack one pushes (MoorDyn gives its size)."""
    end, inner = (count, count - 1) if last else (0, 1)
    pull = np.array(moordyn.GetLineNodeTen(line, end))
    along = np.array(moordyn.GetLineNodePos(line, inner)) - np.array(moordyn.GetLineNodePos(line, end))
    return float(np.linalg.norm(pull) * (np.sign(pull @ along) or 1.0) * (-1.0 if last else 1.0))


def _write_grid(scene: Scene, folder: Path, duration: float, across: tuple[int, int]) -> None:
    """Elevation at the origin, with the scene's ramp, and the grid around the mooring, as WaveKin 3 asks for them."""
    sea = make_sea(replace(scene.sea, interpolation="none"))
    # whole periods of a regular wave, so that its Fourier series has one line; room at the end for an irregular one
    period = 2 * np.pi / float(sea.waves.omega[0])
    if sea.waves.size == 1:
        last = period * np.ceil(duration / period + 1.0)
    else:
        last = duration + 100.0
    t = np.arange(0.0, last, 0.5 * GRID_STEP)
    eta = np.sum(np.asarray(sea.waves.amplitude) * np.cos(sea.waves.phase - np.outer(t, sea.waves.omega)), axis=1)
    if scene.sea.ramp is not None:
        eta = eta * np.sin(0.5 * np.pi * np.clip(t / scene.sea.ramp, 0.0, 1.0)) ** 2
    rows = "\n".join(f"{a:.6f} {b:.9f}" for a, b in zip(t, eta, strict=True))
    (folder / "wave_elevation.txt").write_text(rows + "\n")
    words = [f"{low} {high} {count}" for low, high, count in ((*GRID, 61), (*across, 2), (-30, 10, 41))]
    axes = "\n".join(f"2\n{word}" for word in words)
    (folder / "water_grid.txt").write_text(f"grid\nx, y, z\n-\n{axes}\n")


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of a library on the standard streams."""
    sys.stdout.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    with open(os.devnull, "w") as nothing:
        for stream in (1, 2):
            os.dup2(nothing.fileno(), stream)
        try:
            yield
        finally:
            for stream, saved in zip((1, 2), kept, strict=True):
                os.dup2(saved, stream)
                os.close(saved)


@contextmanager
def moordyn_system(
    scene: Scene, dt: float, duration: float, across: tuple[int, int] | None = None, **more
) -> Iterator[tuple]:
    """The package and its system on the file written of a scene; what it raises ends the run.

    Args:
        across: least and largest y [m] of the grid of waves (WaveKin 3); None: its exact kinematics (WaveKin 7).
        more: options of MoorDyn. With `tScheme` None the file names neither scheme nor step: MoorDyn's step then
            follows from the natural frequencies of the lines.
    """
    import moordyn

    options = {"tScheme": "rk2", "disableOutput": 1, "disableOutTime": 1, "dtOut": duration, **more}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), quiet():
        if across is not None:
            options |= {"WaveKin": 3, "dtWave": GRID_STEP}
            _write_grid(scene, Path(folder), duration, across)
        file = Path(folder) / "mooring.txt"
        chosen = options["tScheme"] is not None
        write_moordyn(scene, file, dt=dt, options={key: x for key, x in options.items() if x is not None})
        if not chosen:
            lines = file.read_text().splitlines()
            file.write_text("\n".join(line for line in lines if not line.endswith(" dtM")) + "\n")
        system = moordyn.Create("mooring.txt")
        try:
            yield moordyn, system
        except RuntimeError:
            pass
        finally:
            moordyn.Close(system)


@dataclass
class Looks:
    """A run as it is seen at times (k,): tensions (k, ends) [N], positions (k, points, 3) [m], and the time it took.

    Attributes:
        start: the positions (points, 3) [m] before the first step; None where MoorDyn finds none.
    """

    t: np.ndarray
    tension: np.ndarray
    position: np.ndarray
    cpu_s: float
    status: str
    start: np.ndarray | None = None


def looks_at(
    scene: Scene,
    dt: float,
    duration: float,
    look: float,
    ends: Sequence[tuple[int, bool]],
    points: Sequence[tuple[int, bool]],
    drive: Callable[[float], np.ndarray] | None = None,
    call: float | None = None,
    speed: np.ndarray | None = None,
    **options,
) -> Looks:
    """MoorDyn at several ends of lines; it stops where a tension is not finite or a position is beyond `FARTHEST`.

    Args:
        dt: its time step [s].
        look: time between looks [s]: extremes between them are not seen.
        ends, points: number of a line from 1, and whether its last end is meant: where the tension of the end segment
            is read (negative where the damper of a slack one pushes), and the position.
        drive: positions (3 m,) [m] over time of its coupled points. Between calls they move at constant velocity: its
            jumps let the line ring, so that errors are measured with a call at every step (0.01 s: 4e-2 in the
            deviation of a gently driven chain, 1 ms: 1e-4).
        call: time between calls [s], at most `look`; None: `look`.
        speed: velocities (3 m,) [m/s] of the coupled points at the start; None: at rest.
        options: of `moordyn_system`.
    """
    calls = max(1, round(look / (call or look)))
    tension = []
    position = []
    start = None
    cpu = 0.0
    span = look / calls
    count = round(duration / look)
    good = False
    with moordyn_system(scene, dt, duration, **options) as (moordyn, system):
        x = [] if drive is None else list(drive(0.0))
        v = [0.0] * len(x) if speed is None else list(speed)
        moordyn.Init(system, x, v)
        lines = {i: moordyn.GetLine(system, i) for i, _ in (*ends, *points)}
        last_node = {i: moordyn.GetLineN(line) for i, line in lines.items()}

        def positions() -> list:
            return [moordyn.GetLineNodePos(lines[i], last_node[i] * last) for i, last in points]

        start = np.array(positions(), float)
        for now in range(count * calls):
            if drive is not None:
                x = list(drive(now * span))
                v = list((drive((now + 1) * span) - drive(now * span)) / span)
            cpu += timed(partial(moordyn.Step, system, x, v, now * span, span))[1]["processor_s"]
            if (now + 1) % calls == 0:
                tension.append([_signed(moordyn, lines[i], last_node[i], last) for i, last in ends])
                position.append(positions())
                good = np.all(np.isfinite(tension[-1])) and np.all(np.abs(position[-1]) < FARTHEST)
                if not good:
                    break
    return Looks(
        t=np.round(look * np.arange(1, len(tension) + 1), 9),
        tension=np.array(tension, float).reshape(len(tension), len(ends)),
        position=np.array(position, float).reshape(len(position), len(points), 3),
        cpu_s=cpu,
        status="ok" if good and len(tension) == count else f"unstable at {len(tension) * look:.4g} s",
        start=start,
    )


def theirs(scene: Scene, dt: float, duration: float, look: float = SAMPLE, **options) -> Rows:
    """MoorDyn on the first line of a scene, seen every `look` [s]; options are those of `looks_at`."""
    seen = looks_at(scene, dt, duration, look, ((1, False), (1, True)), ((1, True),), **options)
    return rows_of(seen, max(1, round(SAMPLE / look)))


def rows_of(seen: Looks, inner: int) -> Rows:
    """Rows of `inner` looks each, of two ends and one point."""
    whole = len(seen.t) // inner * inner
    ends = seen.tension[:whole].reshape(-1, inner, 2)
    size = np.abs(ends)
    return Rows(
        t=seen.t[inner - 1 : whole : inner],
        mean=ends.mean(axis=1),
        square=(ends**2).mean(axis=1),
        least=ends.min(axis=1),
        most=ends.max(axis=1),
        place=seen.position[inner - 1 : whole : inner, 0],
        cpu_s=seen.cpu_s,
        status=seen.status,
        sizes=np.stack([size.mean(axis=1), size.min(axis=1), size.max(axis=1)], axis=1),
    )
