"""Coupling: another program moves prescribed points of a scene and gets the forces on them, step by step."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, SimulationError, nearest
from dropper_jax.base.files import atomic_write
from dropper_jax.effects.coupled_motion import CoupledMotion
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Displacement, Model
from dropper_jax.run.build import SceneLike, build_model, stepper_of
from dropper_jax.run.carry import name_leaves, restore_carry, same_scene
from dropper_jax.run.coupled_forces import half_link_mass, point_forces, set_free
from dropper_jax.run.start import initial_state
from dropper_jax.stepping.integrate import Progress, begin, step_failed
from dropper_jax.stepping.step import step
from dropper_jax.stepping.stepper import FULL_STEP, Stepper

Vectors = Sequence[Sequence[float]] | np.ndarray


class _CoupledStepResult(NamedTuple):
    """Result of some steps: progress, maximum residual, steps solved by the fallback, forces (c, 3) [N]."""

    progress: Progress
    residual: jax.Array
    retried: jax.Array
    forces: jax.Array


class _Motion(NamedTuple):
    """Positions, velocities and accelerations (c, 3) of the coupled points at the end of the last step."""

    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray


class _Saved(NamedTuple):
    """The whole state of a coupling."""

    progress: Progress
    motion: _Motion
    forces: np.ndarray


@cached_jit(static=("stepper", "coupled"))
def _go(
    stepper: Stepper, model: Model, free: Model, progress: Progress, h: jax.Array, count: jax.Array, coupled: tuple
) -> _CoupledStepResult:
    """`count` steps of h [s]."""

    def one(_: jax.Array, result: tuple[Any, ...]) -> tuple[Any, ...]:
        (s0, done, first_bad), residual, retried = result
        s, report = step(stepper, model, s0, h, first_bad < 0)
        bad = step_failed(stepper, model, s, report.residual)
        first_bad = jnp.where(bad & (first_bad < 0), done, first_bad)
        # not `maximum`, which would lose a NaN
        worst = jnp.where(report.residual <= residual, residual, report.residual)
        return Progress(s, done + 1, first_bad), worst, retried + (report.level > FULL_STEP)

    zero = jnp.zeros((), model.dtype), jnp.zeros((), jnp.int32)
    progress, residual, retried = jax.lax.fori_loop(0, count, one, (progress, *zero))
    return _CoupledStepResult(progress, residual, retried, point_forces(model, free, progress.state, coupled))


_forces = cached_jit(static=("points",))(point_forces)


class Coupled:
    """A scene with points moved by another program, which prescribes their motion and gets the forces on them.

        c = dj.Coupled("mooring.txt", points=["fairlead"])
        force = c.init()                              # (c, 3) [N], at rest
        force = c.step(positions, velocities, dt)     # positions and velocities at the end of dt

    Within a step a point moves along the cubic through both positions and velocities (the quintic with accelerations).
    A coupling step consists of a whole number of inner steps of `run.dt` or slightly less. The force on a point is the
    sum of the tensions along the end links of its lines in the last inner step. Weight, buoyancy and drag of the half
    links that belong to the point are added:

        F = sum_j T_j d_j/|d_j| + F_effects,    d_j from the point along link j

    The inertia of these halves is left out: add `mass` to that of the body. Forces come from the last inner step. A
    body that uses them explicitly therefore needs steps that are short compared with its own periods.

    Args:
        scene: as for `simulate`; its `[run]` gives the scheme and the maximum inner step.
        points: names of fixed points of the scene; default: the fixed point, if there is only one.
        dt: maximum inner step [s]; default that of the scene.
        accelerations: whether `init` and `step` take accelerations.

    Attributes:
        points: names of the coupled points, the rows of all arrays.
        time: [s].
        forces: forces of the last step (c, 3) [N].
        mass: of the halves of links at the points (c,) [kg], added mass left out.
        status: `ok`, or how the last step failed: `not_converged`, `non_finite`.
        failure: the reason in one line; empty if the step succeeded.
        residual, retried: of the last step: maximum scaled residual, inner steps solved by the fallback.

    Raises:
        SceneError: points that are not fixed or already move, a scheme that chooses its own steps.
    """

    def __init__(
        self,
        scene: SceneLike,
        points: Sequence[str] | None = None,
        dt: float | None = None,
        accelerations: bool = False,
    ) -> None:
        scene = load_scene(scene)
        self.scene: Scene = scene if dt is None else scene.with_values({"run.dt": dt})
        self.points = _points(self.scene, points)
        self.accelerations = accelerations
        self.status, self.failure, self.residual, self.retried = "ok", "", 0.0, 0
        self._model: Model | None = None
        self._saved: _Saved | None = None

    def init(self, positions: Vectors | None = None, velocities: Vectors | None = None) -> np.ndarray:
        """Start at t = 0 as defined in the scene's `[start]`, with the points at `positions` (c, 3) [m].

        Args:
            positions: default: as in the scene; lines that start at rest are in equilibrium with these positions.
            velocities: of the points (c, 3) [m/s]; default at rest.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: no equilibrium found, values that are not finite or not of this shape.
        """
        home = np.array([self.scene.point(name).position for name in self.points])
        all_positions = home if positions is None else self._read("positions", positions)
        rates = np.zeros_like(all_positions) if velocities is None else self._read("velocities", velocities)
        here = self._moved_to(all_positions)
        model = build_model(here)
        if any(e.moves(name) for e in model.having(Displacement) for name in self.points):
            raise SceneError("points: already moved by an effect of the scene; allowed: fixed points")
        motion = CoupledMotion.uniform(self.points, all_positions, rates, self.accelerations)
        self._model = replace(model, effects=(*model.effects, motion)).cast(model.dtype)
        self._indices = tuple([p.name for p in model.points].index(name) for name in self.points)
        self._free = set_free(model, self._indices)
        self._stepper = stepper_of(self._model, here.run)
        if self._stepper.integrator.controls_error or here.run.step_tolerance is not None:
            raise SceneError("run: chooses its own steps, which a coupling cannot use. Use a scheme of equal steps")
        self._plain = self._stepper.until_converged or not model.laws
        progress = begin(self._stepper, self._model, initial_state(self._model, here.start))
        forces = np.asarray(_forces(self._model, self._free, progress.state, points=self._indices))
        self._saved = _Saved(progress, _Motion(all_positions, rates, np.zeros_like(all_positions)), forces)
        self.status, self.failure = "ok", ""
        return forces.copy()

    def step(
        self, positions: Vectors, velocities: Vectors, dt: float, accelerations: Vectors | None = None
    ) -> np.ndarray:
        """Advance by dt [s] to positions (c, 3) [m] and velocities [m/s] of the points at its end.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: values that are not finite or not of this shape, a step before `init`.
            SimulationError: the step failed, see `status`; the state is that before the step.
        """
        most = 1_000_000  # maximum number of inner steps of one coupling step
        saved = self._state()
        if not (math.isfinite(dt) and dt > 0.0):
            raise SceneError(f"dt: {dt} is out of range; allowed: more than 0 s")
        if (accelerations is not None) != self.accelerations:
            raise SceneError("accelerations: need Coupled(accelerations=True); allowed: in every step or in none")
        read = [self._read("positions", positions), self._read("velocities", velocities)]
        bends = np.zeros_like(read[0]) if accelerations is None else self._read("accelerations", accelerations)
        to = _Motion(*read, bends)
        count = max(1, math.ceil(dt / self.scene.run.dt - 1e-9))
        if count > most:
            why = f"is {count:.3g} inner steps of {self.scene.run.dt:g} s"
            raise SceneError(f"dt: {dt:g} s {why}; allowed: at most {most}")
        model = self._moving(saved, to, dt)
        result = self._advance(model, saved.progress, dt / count, count)
        self.residual, self.retried = float(result.residual), int(result.retried)
        forces = np.asarray(result.forces)
        bad = int(result.progress.first_bad) >= 0
        if bad or not np.all(np.isfinite(forces)):
            self._fail(dt, count)
        self.status, self.failure = "ok", ""
        self._saved = _Saved(result.progress, to, forces)
        return forces.copy()

    def save(self, path: str | Path | None = None) -> dict[str, np.ndarray]:
        """The whole state as arrays; also written to an `.npz` file if a path is given."""
        arrays = name_leaves(self._state())
        if path is not None:
            text = np.array(json.dumps({"scene": self.scene.as_written(), "points": self.points}))
            atomic_write(path, lambda file: np.savez_compressed(file, meta=text, **arrays))
        return arrays

    def restore(self, saved: dict[str, np.ndarray] | str | Path) -> np.ndarray:
        """Return to a state given by `save`; the continuation is bit-identical.

        Returns:
            Forces on the points (c, 3) [N].

        Raises:
            SceneError: a file of another scene or of other points, or not written by `save`.
        """
        if self._saved is None:
            self.init()
        arrays = saved if isinstance(saved, dict) else self._read_file(Path(saved))
        found = restore_carry(self._state(), arrays)
        motion = _Motion(*(np.asarray(a) for a in found.motion))
        self._saved = _Saved(found.progress, motion, np.asarray(found.forces))
        self.status, self.failure = "ok", ""
        return self._saved.forces.copy()

    @property
    def time(self) -> float:
        return float(self._state().progress.state.t)

    @property
    def forces(self) -> np.ndarray:
        return self._state().forces.copy()

    @property
    def mass(self) -> np.ndarray:
        self._state()
        return np.asarray(half_link_mass(self._free, self._indices))

    @property
    def positions(self) -> np.ndarray:
        """All nodes, line after line, both ends of each included (n + lines, 3) [m]."""
        s, motion = self._state().progress.state, self._state().motion
        model = self._moving(self._state(), motion, 1.0, at=float(s.t))
        return np.asarray(model.nodes(s.r, model.ends(s.t)))

    @property
    def tension(self) -> np.ndarray:
        """Tensions of all links (n,) [N] in the last step."""
        return np.asarray(self._state().progress.state.tension)

    def _state(self) -> _Saved:
        if self._saved is None:
            raise SceneError("Coupled: not initialised. Call `init` first")
        return self._saved

    def _advance(self, model: Model, progress: Progress, h: float, count: int) -> _CoupledStepResult:
        """The inner steps; if the plain program does not converge, by the program with the fallback solvers."""
        given = model, self._free, progress, jnp.asarray(h, model.dtype), jnp.asarray(count, jnp.int32)
        result = _go(self._stepper.plain if self._plain else self._stepper, *given, coupled=self._indices)
        if self._plain and int(result.progress.first_bad) >= 0 and self._stepper != self._stepper.plain:
            self._plain = False
            result = _go(self._stepper, *given, coupled=self._indices)
        return result

    def _moving(self, saved: _Saved, to: _Motion, dt: float, at: float | None = None) -> Model:
        """The model with points that move from their present to the given positions."""
        pairs = [np.stack(both) for both in zip(saved.motion, to, strict=True)]
        t = float(saved.progress.state.t) if at is None else at
        model, motion = self._model, self._model.effects[-1]
        positions, rates, bends = (jnp.asarray(a, model.dtype) for a in pairs)
        values = {"begin": jnp.asarray(t, model.dtype), "width": jnp.asarray(dt, model.dtype)}
        bends = bends if self.accelerations else None
        motion = replace(motion, places=positions, velocities=rates, accelerations=bends, **values)
        return replace(model, effects=(*model.effects[:-1], motion))

    def _moved_to(self, positions: np.ndarray) -> Scene:
        names = [p.name for p in self.scene.points]
        home = [self.scene.point(name).position for name in self.points]
        if all(np.array_equal(a, b) for a, b in zip(positions, home, strict=True)):
            return self.scene
        where = zip(self.points, positions, strict=True)
        return self.scene.with_values({f"point.{names.index(name)}.position": p.tolist() for name, p in where})

    def _fail(self, dt: float, count: int) -> None:
        end = self.time + dt
        if not math.isfinite(self.residual):
            self.status, why = "non_finite", "non-finite values"
        else:
            self.status, why = "not_converged", f"scaled residual {self.residual:.3g}"
        self.failure = f"{self.status}: the step to t = {end:.6g} s, {count} inner steps of {dt / count:.3g} s: {why}"
        raise SimulationError(self.failure)

    def _read(self, what: str, values: Vectors) -> np.ndarray:
        found = np.array(values, float)  # a copy: the caller may change its own array in place
        shape = (len(self.points), 3)
        if found.shape == (3,) and shape[0] == 1:
            found = found[None]
        if found.shape != shape:
            raise SceneError(f"{what}: has shape {list(found.shape)}; allowed: {list(shape)}, a row per point")
        if not np.all(np.isfinite(found)):
            row = int(np.flatnonzero(~np.all(np.isfinite(found), axis=1))[0])
            raise SceneError(f"{what}: {found[row].tolist()} of {self.points[row]!r} is not finite; allowed: numbers")
        return found

    def _read_file(self, path: Path) -> dict[str, np.ndarray]:
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(str(arrays.pop("meta")))
            scene, points = Scene.from_dict(meta["scene"]), tuple(meta["points"])
        except OSError as error:
            raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
        except Exception:  # any error of a file in another format
            raise SceneError(f"{path}: not a saved coupling; allowed: a file written by `Coupled.save`") from None
        same_scene(self.scene, scene)
        if points != self.points:
            raise SceneError(f"{path}: couples {', '.join(points)}; allowed: {', '.join(self.points)}")
        return arrays


def _points(scene: Scene, given: Sequence[str] | None) -> tuple[str, ...]:
    """The coupled points, checked."""
    held = [p.name for p in scene.points if not p.is_free]
    if given is None:
        if len(held) != 1:
            raise SceneError(f"points: missing; needed: names of the fixed points that move: {', '.join(held)}")
        return tuple(held)
    names = (given,) if isinstance(given, str) else tuple(given)
    for i, name in enumerate(names):
        if name not in held:
            raise SceneError(f"points.{i}: {name!r} is not a fixed point; {nearest(name, held)}")
        if name in names[:i]:
            raise SceneError(f"points.{i}: {name!r} is a duplicate; allowed: every point once")
    if not names:
        raise SceneError(f"points: is empty; allowed: names of fixed points: {', '.join(held)}")
    return names
