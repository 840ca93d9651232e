"""The same scene in MoorDyn v2 and here: runs that give end tensions and the place of the far end at equal times."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from study import Found

from dropper_jax import Scene, step
from dropper_jax.model import Model, State
from dropper_jax.moordyn.writing.writer import write_moordyn
from dropper_jax.run.build import build, stepper_of
from dropper_jax.sea.make import make_sea
from dropper_jax.stepping.adaptive import adaptive_start, advance_adaptively
from dropper_jax.stepping.integrate import begin
from dropper_jax.stepping.stepper import FULL_STEP, Stepper
from dropper_jax.study.peers.moordyn_run import inside, quiet

#: Time between rows [s], in both codes.
SAMPLE = 0.1
#: Time between the tables of a wave grid [s].
GRID_STEP = 0.1


@dataclass
class Rows:
    """A run: times (k,), and per row the mean, least and largest tension at both ends (k, 2) and the far end's place.

    Attributes:
        square: mean square of the tensions.
        wall_s, cpu_s: wall and processor time of the run without compilation or file reading. Both codes run on one
            thread, so that the two differ only by what else the machine does.
        retried: steps taken again, as a share; with a tolerance those refused.
        status: `ok` or what went wrong.
        steps: of ours, how many were taken.
        sizes: of MoorDyn, mean, least and largest size of the end tensions (k, 3, 2), pushing counted as pulling.
    """

    t: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    least: np.ndarray
    most: np.ndarray
    place: np.ndarray
    wall_s: float
    cpu_s: float
    retried: float = 0.0
    status: str = "ok"
    sizes: np.ndarray | None = None
    steps: int | None = None

    def peaks(self, start: float, window: float) -> float:
        """Mean of the largest fairlead tensions [N] in windows of `window` [s] from `start` on."""
        most = self.most[self.t > start + 0.5 * SAMPLE, 1]
        each = round(window / SAMPLE)
        return float(np.mean(most[: len(most) // each * each].reshape(-1, each).max(axis=1)))

    def statistics(self, start: float = 0.0) -> Found:
        """Tension of anchor and fairlead [N] and ranges of the far end [m], from `start` on.

        `std` is that of all steps (or looks), `std_of_rows` that of the means over SAMPLE: below 5 Hz.
        """
        kept = self.t > start
        found = {"status": self.status, "retried": self.retried}
        if self.status != "ok":
            return found
        for i, name in enumerate(("anchor", "fairlead")):
            mean, square = float(np.mean(self.mean[kept, i])), float(np.mean(self.square[kept, i]))
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
        low, high = np.min(self.place[kept], axis=0), np.max(self.place[kept], axis=0)
        found["place"] = {"min": low.tolist(), "max": high.tolist(), "mean": np.mean(self.place[kept], axis=0).tolist()}
        return found


def _rows(model: Model, carry, advance: Callable, seen: Callable, every, saves: int):
    """Rows of `every` steps each, of the first line: tensions of its ends, its far end's place, whether all is well.

    Args:
        advance: what is carried a step on, and mean, mean square, least and largest tension (2,) of both ends in it.
        seen: the state and whether all is well, of what is carried.
    """
    zero = jnp.zeros(2, model.dtype)

    def one(_: jax.Array, inner):
        carry, total, square, least, most = inner
        carry, (mean, squares, low, high) = advance(carry)
        return carry, total + mean, square + squares, jnp.minimum(least, low), jnp.maximum(most, high)

    def save(carry, _: None):
        start = (carry, zero, zero, zero + jnp.inf, zero - jnp.inf)
        carry, total, square, least, most = jax.lax.fori_loop(0, every, one, start)
        s, alive = seen(carry)
        place = model.geometry.everywhere(s.r, model.ends(s.t).positions)[model.geometry.last[0]]
        return carry, (total / every, square / every, least, most, place, alive)

    return jax.lax.scan(save, carry, None, length=saves)


@partial(jax.jit, static_argnames=("stepper", "saves", "links"))
def _march(stepper: Stepper, model: Model, s: State, dt: jax.Array, every: jax.Array, saves: int, links: int):
    """Steps of dt [s]; how many were taken again, and rows."""

    def advance(carry):
        s, alive, again = carry
        s, report = step(stepper, model, s, dt, alive)
        ends = s.tension[jnp.array([0, links - 1])]
        alive = alive & (report.residual <= stepper.limit(model))
        return (s, alive, again + (report.level > FULL_STEP)), (ends, ends**2, ends, ends)

    carry = (begin(stepper, model, s).state, jnp.array(True), jnp.zeros((), jnp.int32))
    (_, _, again), rows = _rows(model, carry, advance, lambda carry: carry[:2], every, saves)
    return (again, saves * every), rows


@partial(jax.jit, static_argnames=("stepper", "saves", "links"))
def _follow(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: jax.Array,
    every: jax.Array,
    tolerance: jax.Array,
    saves: int,
    links: int,
):
    """As `_march`, in steps that follow the snaps: `every` intervals of dt [s] per row, the longest steps."""
    ends = jnp.array([0, links - 1])

    def advance(carry):
        adaptive, steps = carry
        adaptive, (_, within) = advance_adaptively(stepper, model, adaptive, dt, tolerance, 1)
        return (adaptive, steps + within.steps[0]), tuple(a[0, ends] for a in within[:4])

    def seen(carry):
        return carry[0].progress.state, carry[0].progress.first_bad < 0

    carry = (adaptive_start(begin(stepper, model, s), dt), jnp.zeros((), jnp.int32))
    (adaptive, steps), rows = _rows(model, carry, advance, seen, every, saves)
    return (adaptive.refused, steps), rows


@dataclass
class Ours:
    """A scene here, compiled once for all step sizes."""

    stepper: Stepper
    model: Model
    start: State
    links: int
    compiled: dict = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> "Ours":
        model, start = build(scene)
        return cls(stepper_of(model, scene.run, track_work=False), model, start, len(scene.lines[0].length))

    def other(self, scene: Scene) -> "Ours":
        """The same for a scene that differs in values only: the programs serve it too."""
        model, start = build(scene)
        return replace(self, model=model, start=start)

    def run(self, every: int, duration: float, repeats: int = 1, tolerance: float | None = None) -> Rows:
        """Steps of SAMPLE / every [s], or with a tolerance [m/s] at most so long; the least times count."""
        saves = round(duration / SAMPLE)
        given = [self.model, self.start, jnp.asarray(SAMPLE / every), jnp.asarray(every)]
        program = _march
        if tolerance is not None:
            program = _follow
            given.append(jnp.asarray(tolerance))
        wall = cpu = np.inf
        if (program, saves) not in self.compiled:
            lowered = program.lower(self.stepper, *given, saves=saves, links=self.links)
            self.compiled[program, saves] = lowered.compile()
        for _ in range(repeats):
            begun, used = time.perf_counter(), time.process_time()
            (again, steps), rows = jax.block_until_ready(self.compiled[program, saves](*given))
            wall, cpu = min(wall, time.perf_counter() - begun), min(cpu, time.process_time() - used)
        mean, square, least, most, place, alive = (np.asarray(a) for a in rows)
        t = SAMPLE * np.arange(1, saves + 1)
        status = "ok" if bool(alive[-1]) else f"not_converged at {t[np.argmin(alive)]:.4g} s"
        return Rows(
            t, mean, square, least, most, place, wall, cpu, float(again) / float(steps), status, steps=int(steps)
        )


def _signed(moordyn, line, end: int, inner: int) -> float:
    """Tension [N] of an end segment, negative where the damper of a slack one pushes (MoorDyn gives its size)."""
    pull = np.array(moordyn.GetLineNodeTen(line, end))
    along = np.array(moordyn.GetLineNodePos(line, inner)) - np.array(moordyn.GetLineNodePos(line, end))
    return float(np.linalg.norm(pull) * (np.sign(pull @ along) or 1.0) * (1.0 if end < inner else -1.0))


def _write_grid(scene: Scene, folder: Path, duration: float, across: tuple[int, int] = (-60, 60)) -> None:
    """Elevation at the origin, with the scene's ramp, and the grid around the mooring, as WaveKin 3 asks for them."""
    sea = make_sea(replace(scene.sea, interpolation="none"))
    # whole periods of a regular wave, so that its Fourier series has one line; room at the end for an irregular one
    period = 2 * np.pi / float(sea.waves.omega[0])
    last = period * np.ceil(duration / period + 1.0) if sea.waves.size == 1 else duration + 100.0
    t = np.arange(0.0, last, 0.5 * GRID_STEP)
    eta = np.sum(np.asarray(sea.waves.amplitude) * np.cos(sea.waves.phase - np.outer(t, sea.waves.omega)), axis=1)
    if scene.sea.ramp is not None:
        eta = eta * np.sin(0.5 * np.pi * np.clip(t / scene.sea.ramp, 0.0, 1.0)) ** 2
    rows = "\n".join(f"{a:.6f} {b:.9f}" for a, b in zip(t, eta, strict=True))
    (folder / "wave_elevation.txt").write_text(rows + "\n")
    words = [f"{low} {high} {count}" for low, high, count in ((-60, 60, 61), (*across, 2), (-30, 10, 41))]
    axes = "\n".join(f"2\n{word}" for word in words)
    (folder / "water_grid.txt").write_text(f"grid\nx, y, z\n-\n{axes}\n")


@contextmanager
def moordyn_system(
    scene: Scene, dt: float, duration: float, scheme: str = "rk2", across: tuple[int, int] | None = None, **more
) -> Iterator[tuple]:
    """The package and its system on the file written of a scene; what it raises ends the run.

    Args:
        across: least and largest y [m] of the grid of waves (WaveKin 3); None: its exact kinematics (WaveKin 7).
        more: options of MoorDyn.
    """
    import moordyn

    options = {"tScheme": scheme, "disableOutput": 1, "disableOutTime": 1, "dtOut": duration, **more}
    with tempfile.TemporaryDirectory() as folder, inside(folder), quiet():
        if across is not None:
            options |= {"WaveKin": 3, "dtWave": GRID_STEP}
            _write_grid(scene, Path(folder), duration, across)
        write_moordyn(scene, Path(folder) / "mooring.txt", dt=dt, options=options)
        system = moordyn.Create("mooring.txt")
        try:
            yield moordyn, system
        except RuntimeError:
            pass
        finally:
            moordyn.Close(system)


def theirs(
    scene: Scene,
    dt: float,
    duration: float,
    scheme: str = "rk2",
    look: float = SAMPLE,
    drive: Callable[[float], np.ndarray] | None = None,
    grid: bool = False,
    across: tuple[int, int] = (-60, 60),
    call: float | None = None,
) -> Rows:
    """MoorDyn on the scene, with its exact kinematics (WaveKin 7) or those of a grid (WaveKin 3).

    Args:
        grid: whether wave kinematics come from a grid; the waves must travel in +x.
        across: least and largest y of the grid [m].
        dt: its time step [s].
        look: time between looks at its tensions [s]: extremes between them are not seen.
        drive: place (3,) [m] over time of its coupled point. Between calls the point moves at constant velocity: its
            jumps let the line ring, so that errors are measured with a call at every step (0.01 s: 4e-2 in the
            deviation of a gently driven chain, 1 ms: 1e-4).
        call: time between calls [s], at most `look`; None: `look`.
    """
    looks = max(1, round(SAMPLE / look))
    inner, rows, wall, cpu = looks * max(1, round(SAMPLE / looks / (call or look))), [], 0.0, 0.0
    with moordyn_system(scene, dt, duration, scheme, across if grid else None) as (moordyn, system):
        first = [] if drive is None else list(drive(0.0))
        moordyn.Init(system, first, [0.0] * len(first))
        line = moordyn.GetLine(system, 1)
        count, now = moordyn.GetLineN(line), 0
        for _ in range(round(duration / SAMPLE)):
            ends = []
            for _ in range(inner):
                t = now * SAMPLE / inner
                x = [] if drive is None else list(drive(t))
                v = [] if drive is None else list((drive(t + SAMPLE / inner) - drive(t)) / (SAMPLE / inner))
                begun, used = time.perf_counter(), time.process_time()
                moordyn.Step(system, x, v, t, SAMPLE / inner)
                wall, cpu = wall + time.perf_counter() - begun, cpu + time.process_time() - used
                now += 1
                if now % (inner // looks):
                    continue
                ends.append([_signed(moordyn, line, i, j) for i, j in ((0, 1), (count, count - 1))])
            rows.append((np.array(ends), moordyn.GetLineNodePos(line, count)))
            if not np.all(np.isfinite(ends)):
                break
    wanted = round(duration / SAMPLE)
    status = (
        "ok" if len(rows) == wanted and np.all(np.isfinite(rows[-1][0])) else f"unstable at {len(rows) * SAMPLE:.4g} s"
    )
    if not rows:
        rows = [(np.full((1, 2), np.nan), (np.nan,) * 3)]
    ends = [row[0] for row in rows]
    return Rows(
        t=SAMPLE * np.arange(1, len(rows) + 1),
        mean=np.array([e.mean(axis=0) for e in ends]),
        square=np.array([(e**2).mean(axis=0) for e in ends]),
        least=np.array([e.min(axis=0) for e in ends]),
        most=np.array([e.max(axis=0) for e in ends]),
        place=np.array([row[1] for row in rows], float),
        wall_s=wall,
        cpu_s=cpu,
        status=status,
        sizes=np.array([(a.mean(axis=0), a.min(axis=0), a.max(axis=0)) for a in map(np.abs, ends)]),
    )


def theirs_many(
    scene: Scene,
    dt: float,
    duration: float,
    look: float,
    ends: Sequence[tuple[int, bool]],
    places: Sequence[tuple[int, bool]],
    across: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """MoorDyn (rk2) on its wave grid, at several ends of lines.

    Args:
        ends, places: number of a line from 1, and whether its last end is meant: where the size of the tension of the
            end segment is read, and the place.
        across: least and largest y of the grid [m].

    Returns:
        times (k,), sizes of tensions (k, ends) [N], places (k, places, 3) [m], and `ok` or what went wrong.
    """
    pulls, where = [], []
    with moordyn_system(scene, dt, duration, across=across, waveKin_rampT=0.0) as (moordyn, system):
        moordyn.Init(system, [], [])
        lines = {i: moordyn.GetLine(system, i) for i, _ in (*ends, *places)}
        last = {i: moordyn.GetLineN(line) for i, line in lines.items()}
        for step_number in range(round(duration / look)):
            moordyn.Step(system, [], [], step_number * look, look)
            pulls.append([np.linalg.norm(moordyn.GetLineNodeTen(lines[i], last[i] * far)) for i, far in ends])
            where.append([moordyn.GetLineNodePos(lines[i], last[i] * far) for i, far in places])
            if not np.all(np.isfinite(pulls[-1])):
                break
    t = look * np.arange(1, len(pulls) + 1)
    good = len(pulls) == round(duration / look) and np.all(np.isfinite(pulls[-1]))
    status = "ok" if good else f"unstable at {len(pulls) * look:.4g} s"
    return t, np.array(pulls, float).reshape(-1, len(ends)), np.array(where, float).reshape(-1, len(places), 3), status
