"""What several test files share: scenes as plain values, and one compiled program per scheme for any step size."""

import gc
import html
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

#: Most of the time of these tests goes into compiling programs that run once and shortly. With these flags XLA compiles
#: the same operations in a quarter of the time (lab dropper: 2.3 s to 0.6 s): the loop of each fused operation is
#: written directly instead of through MLIR, all in one piece, and LLVM does not optimise. Passes over loops and sums,
#: a fifth of the remaining time, are left out. Results differ by rounding only, which test_compilation.py checks
#: against programs compiled as users get them. TESTS_CHOSE_XLA_FLAGS=no leaves the flags alone, and all tests run what
#: users run.
QUICK_COMPILATION = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_cpu_parallel_codegen_split_count=1",
    "--xla_backend_optimization_level=0",
    "--xla_disable_hlo_passes=while-loop-invariant-code-motion,simplify-while-loops,while-loop-constant-sinking,"
    "reshape-mover,small-while-loop-hoisting",
)


def _known(flags: str) -> bool:
    """Whether this XLA takes the flags: it ends a process over one that it does not know."""
    call, environment = [sys.executable, "-c", "import jax; jax.devices()"], {**os.environ, "XLA_FLAGS": flags}
    return not subprocess.run(call, env=environment, capture_output=True, check=False).returncode


def _compile_quickly() -> None:
    """Set the flags before JAX is there; processes that the tests start (workers, notebooks) inherit them."""
    if "TESTS_CHOSE_XLA_FLAGS" in os.environ:  # a worker: its parent found out
        return
    chosen = os.environ.get("XLA_FLAGS", "")
    wanted = [flag for flag in QUICK_COMPILATION if flag.partition("=")[0] not in chosen]
    os.environ["TESTS_CHOSE_XLA_FLAGS"] = "yes"
    if not _known(" ".join([chosen, *wanted])):
        wanted = [flag for flag in wanted if _known(f"{chosen} {flag}")]
    os.environ["XLA_FLAGS"] = " ".join([chosen, *wanted]).strip()


_compile_quickly()
#: Programs of earlier runs of the tests on this machine: compiled ones of this process, stored ones of commands that
#: tests start. They save two fifths of the time of a second run.
KEPT = Path(__file__).parents[1] / ".pytest_cache" / "programs"
os.environ["XDG_CACHE_HOME"] = str(KEPT / "commands")
# Two workers share two cores: further threads of OpenBLAS only wait (a twelfth of the time of test_bending.py), and so
# do those of OpenCV (a seventh of the time of test_films.py).
for threads in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(threads, "1")
os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "threads;1")
# Tracing makes millions of objects that stay: they are searched for garbage less often (another twelfth).
gc.set_threshold(100_000, 50, 100)
# Loading programs makes XLA write lines about processor features, which a failed test would show.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from hard_scenes import single_line  # noqa: E402
from jax.flatten_util import ravel_pytree  # noqa: E402

import dropper_jax as dj  # noqa: E402
from dropper_jax import Solution  # noqa: E402
from dropper_jax.backend.programs import PROGRAMS, memory_maps, return_memory  # noqa: E402
from dropper_jax.cli import main  # noqa: E402
from dropper_jax.solvers import SOLVERS  # noqa: E402
from dropper_jax.stepping.halving import advance_over  # noqa: E402
from dropper_jax.stepping.progress import begin  # noqa: E402

# JAX's own cache knows programs by their content, so that tests may replace parts of the packages.
jax.config.update("jax_compilation_cache_dir", str(KEPT / "compiled"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
#: Memory maps (870 at first) beyond which programs go after a file: each would compile its small operations again.
MANY_MAPS = 3000


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Files with most slow tests first, then those with most tests: no worker ends alone with a long file."""
    tests = Counter(item.path for item in items)
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: (-slow[item.path], -tests[item.path]))


@pytest.fixture(scope="module", autouse=True)
def _memory_given_back():
    """After each file: where there are many, programs and traces go, with their memory maps and the heap they held.

    A worker would otherwise end with 5 GB, and on the way meet the kernel's 65 530 maps.
    """
    yield
    if not 0 < memory_maps() < MANY_MAPS:
        PROGRAMS.clear()
        return_memory()


@pytest.fixture(scope="session")
def as_a_user():
    """`as_a_user(code, *arguments)`: what Python code prints as JSON, compiled without the flags of the tests."""
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}

    def run(code, *arguments):
        call = [sys.executable, "-c", code, *arguments]
        done = subprocess.run(call, capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@partial(jax.jit, static_argnames=("stepper", "saves"))
def _march(stepper, model, s, dt, every, saves):
    def save(s, _):
        def one(_, carry):
            taken = advance_over(stepper, model, carry[0], dt)
            return taken.state, carry[1] & ~taken.failed

        s, good = jax.lax.fori_loop(0, every, one, (s, True))
        return s, (s.r, s.v, s.tension, good)

    return jax.lax.scan(save, begin(stepper, model, s).state, None, length=saves)[1]


@pytest.fixture(scope="session")
def march():
    """`march(stepper, model, s, duration, steps, saves)`: saved r, v (saves, nodes, 3), T; every step must converge.

    The number of steps is an argument of the compiled program, so that all step sizes share one compilation.
    """

    def run(stepper, model, s, duration, steps, saves=1):
        assert steps % saves == 0
        r, v, tension, good = _march(stepper, model, s, duration / steps, steps // saves, saves)
        assert np.all(good), "a step did not converge"
        return np.asarray(r), np.asarray(v), np.asarray(tension)

    return run


@pytest.fixture
def printed(capsys):
    """`printed(arguments, code)`: what `dropper` prints, `out` and `err`, when it ends with this exit code."""

    def call(arguments, code=0):
        assert main(arguments) == code
        return capsys.readouterr()

    return call


@pytest.fixture
def json_of(printed):
    """The same as JSON."""
    return lambda arguments, code=0: json.loads(printed(arguments, code).out)


@pytest.fixture
def refused(capsys):
    """`refused(arguments)`: the one line of `dropper` on what a user can mend; the object of --json has it too."""

    def call(arguments):
        assert main([*arguments, "--json"]) == 2
        out, err = capsys.readouterr()
        found = json.loads(out)
        assert (found["schema"], found["status"]) == (1, "invalid_input")
        assert err == f"error: {found['error']}\n"
        assert err.count("\n") == 1
        return err

    return call


@pytest.fixture(scope="session")
def refusal():
    """`refusal(call, ...)`: the one line with which a call refuses what it is given."""

    def read(call, *given, **settings):
        with pytest.raises(dj.SceneError) as caught:
            call(*given, **settings)
        message = str(caught.value)
        assert "\n" not in message
        return message

    return read


@pytest.fixture(scope="session")
def both_modes():
    """`both_modes(f)(x)`: f(x) (m,) or a number, its derivatives (m, n) or (n,) in reverse and in forward mode.

    One program gives all three, and the values for differences too: compiled one by one they take twice as long.
    """

    def make(f):
        @jax.jit
        def all_three(x):
            flat, unravel = ravel_pytree(x)
            y, push = jax.linearize(lambda a: f(unravel(a)), flat)
            pull = jax.linear_transpose(push, flat)
            reverse = jax.lax.map(lambda w: pull(w.reshape(y.shape))[0], jnp.eye(y.size)).reshape(*y.shape, -1)
            return y, reverse, jnp.moveaxis(jax.lax.map(push, jnp.eye(flat.size)), 0, -1)

        return all_three

    return make


@pytest.fixture(scope="session")
def slopes_of(both_modes):
    """`slopes_of(f, at, size)`: derivatives of a number by `at`, flat, equal in both modes and to differences.

    Central ones of `size` and of twice that, extrapolated. `floor`: 1 where tolerances are those of the largest.
    """

    def check(f, at, size=1e-4, rel=1e-6, modes=1e-9, floor=0.0):
        run = both_modes(f)
        flat, unravel = ravel_pytree(at)
        _, reverse, forward = (np.asarray(x) for x in run(at))
        largest = floor * np.max(np.abs(reverse))
        np.testing.assert_allclose(forward, reverse, rtol=modes, atol=modes * largest)
        steps = size * jnp.array([1.0, -1.0, 2.0, -2.0])
        for i, unit in enumerate(jnp.eye(flat.size)):
            ends = [float(run(unravel(flat + h * unit))[0]) for h in steps]
            expected = (4 * (ends[0] - ends[1]) / (2 * size) - (ends[2] - ends[3]) / (4 * size)) / 3
            assert reverse[i] == pytest.approx(expected, rel=rel, abs=rel * largest), i
        return reverse

    return check


@pytest.fixture(scope="session")
def network_is_exact():
    """`network_is_exact(model, s, spread)`: the network's solve and its transpose undo the whole Jacobian of a step.

    A step from `s`, whose places (by `spread` [m]), speeds and tensions are shaken; so is what is asked of the step.
    """

    def check(model, s, spread=0.0, within=1e-9):
        rng = np.random.default_rng(1)
        normal = lambda x: jnp.asarray(rng.normal(size=x.shape))  # noqa: E731
        if spread:
            tension = jnp.asarray(rng.uniform(1.0, 5.0, s.tension.shape))
            s = replace(s, r=s.r + spread * normal(s.r), v=0.5 * normal(s.r), tension=tension)
        problem = dj.make_stepper(model).integrator.problem(model, s, jnp.asarray(0.01))
        guess = problem.guess()
        u = guess._replace(x=guess.x + 1e-3 * normal(guess.x), z=tuple(normal(z) for z in guess.z))
        rows = jax.tree.map(normal, u)

        @jax.jit
        def undone(rows):
            linear = SOLVERS["network"].linearise(problem, u)
            ahead = jax.jvp(problem.residual, (u,), (linear.apply(rows),))[1]
            return ahead, jax.vjp(problem.residual, u)[1](linear.transpose().apply(rows))[0]

        for found in undone(rows):
            jax.tree.map(partial(np.testing.assert_allclose, rtol=0.0, atol=within), found, rows)

    return check


@pytest.fixture(scope="session")
def chain():
    """`chain(lengths, masses, start, ...)`: the plain values of a scene with one line between `left` and `right`."""
    return single_line


#: A backbone between two spar buoys, a leg to an anchor at either side, and a sock that hangs below the backbone.
LONGLINE = {
    "name": "made-up-longline",
    "run": {"dt": 0.1, "duration": 6.0},
    "line_type": [
        {"name": "rope", "mass": 5.0, "diameter": 0.05, "EA": 1e6, "breaking_load": 5e4}
        | {"cdn": 1.2, "cdt": 0.1, "can": 1.0, "cat": 0.0}
    ],
    "point": [
        {"name": "anchor-a", "position": [-40.0, 0.0, -20.0]},
        {"name": "left", "kind": "free", "position": [-15.0, 0.0, -1.0]},
        {"name": "right", "kind": "free", "position": [15.0, 0.0, -1.0]},
        {"name": "anchor-b", "position": [40.0, 0.0, -20.0]},
    ],
    "line": [
        {"name": "leg-a", "from": "anchor-a", "to": "left", "type": "rope", "length": 36.0, "links": 4},
        {"name": "backbone", "from": "left", "to": "right", "type": "rope", "length": 30.5, "links": 3},
        {"name": "leg-b", "from": "right", "to": "anchor-b", "type": "rope", "length": 36.0, "links": 4},
        {"name": "sock", "from": "left", "to": "right", "type": "rope", "length": 40.0, "links": 6},
    ],
    "buoy": [
        {"name": "spar-a", "point": "left", "mass": 500.0, "diameter": 1.0, "height": 3.0},
        {"name": "spar-b", "point": "right", "mass": 500.0, "diameter": 1.0, "height": 3.0},
    ],
    "sea": {"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.8, "period": 6.0}},
    "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}, "seabed": {}},
}
#: Depth of the middle of each line below the straight line between its ends [m].
SAG = {"leg-a": 3.0, "backbone": 0.5, "leg-b": 3.0, "sock": 9.0}


@pytest.fixture(scope="session")
def made():
    """`made(scene, positions, tension, dt)`: a solution of given motion, none of it simulated; v by differences."""

    def make(scene, positions, tension, dt=0.1, **changes):
        samples = len(positions)
        t = dt * np.arange(samples)
        fields = {
            "scene": dj.load_scene(scene),
            "settings": {"integrator": "energy_momentum", "solver": "network", "dt": dt, "duration": float(t[-1])}
            | {"steps": samples - 1, "dtype": "float64"},
            "t": t,
            "positions": positions,
            "velocities": np.gradient(positions, dt, axis=0),
            "tension": tension,
            "t_tension": np.maximum(t - dt / 2, 0.0),
            "kinetic": np.ones(samples),
            "potential": np.ones(samples),
            "work": np.zeros((samples, 1)),
            "work_names": ("internal_damping",),
            "step_status": np.zeros(samples, int),
        }
        return Solution(**{**fields, **changes})

    return make


@pytest.fixture(scope="session")
def longline(made):
    """`longline(sideways, samples)`: a made-up motion of a system of four lines, across its plane by `sideways` [m]."""

    def make(sideways=1.5, samples=61, tension=1000.0, **changes):
        scene = dj.load_scene(LONGLINE)
        t, w = 0.1 * np.arange(samples), 2 * np.pi / 6.0
        across = sideways * np.sin(w * t)
        shift = np.stack([np.sin(w * t), across, 0.8 * np.cos(w * t)], axis=1)
        place = {p.name: p.position + (shift if p.kind == "free" else np.zeros_like(shift)) for p in scene.points}
        nodes = []
        for line in scene.lines:
            u = np.linspace(0, 1, line.links + 1)[:, None]
            bow = 4 * u * (1 - u) * np.stack([0 * t, across, 0 * t - SAG[line.name]], axis=1)[:, None]
            nodes.append((1 - u) * place[line.start][:, None] + u * place[line.end][:, None] + bow)
        links = sum(line.links for line in scene.lines)
        pull = tension * (1.0 + 0.3 * np.sin(w * t)[:, None] + 0.1 * np.arange(links) / links)
        return made(scene, np.concatenate(nodes, axis=1), pull, **changes)

    return make


@pytest.fixture(scope="session")
def one_line():
    """`one_line(length, links, start, end, kind, effects, ...)`: a line of one type between two fixed points."""

    def make(length, links, start, end, kind, effects, **more):
        return {
            "run": {"dt": 0.02, "duration": 1.0},
            "line_type": [{"name": "rope", **kind}],
            "point": [{"name": "a", "position": start}, {"name": "b", "position": end}],
            "line": [{"name": "line", "from": "a", "to": "b", "type": "rope", "length": length, "links": links}],
            "effects": effects,
            **more,
        }

    return make


@pytest.fixture(scope="session")
def falling():
    """`falling(period, dt)`: a mass that falls 0.2 m before its rope of 2 m tautens, on which it swings in `period`."""

    def make(period, dt, **run):
        mass, length, places = 100.0, 2.0, [[0.0, 0.0, 0.0], [0.0, 0.0, -1.8]]
        axial = {"law": "rope", "EA": length * mass * (2 * np.pi / period) ** 2}
        line = {"name": "rope", "from": "top", "to": "mass", "links": 1, "length": length, "mass": mass, "axial": axial}
        return {
            "run": {"dt": dt, "duration": 0.4, **run},
            "point": [
                {"name": "top", "position": places[0]},
                {"name": "mass", "kind": "free", "position": places[1]},
            ],
            "line": [line],
            "effects": {"weight": {}},
            "start": {"kind": "positions", "positions": places},
        }

    return make


#: A browser, where there is one: the installation of the tests brings none.
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


@pytest.fixture
def in_browser(tmp_path):
    """`look(page, probe)`: what an expression of JavaScript gives in a page. Skipped where there is no browser."""
    if BROWSER is None:
        pytest.skip("no Chromium here: how the page works is not checked (Debian: chromium)")

    def look(page, probe, options=("--disable-gpu",), after=500, every=None, width=900, file=None):
        """What `probe` gives `after` so many ms of the page's time, or last of those seen `every` so many ms.

        The browser's time runs ahead of messages between frames: what waits for one is looked at again and again.
        Below 500 px, the narrowest window, the page is in a frame; `file` is where it needs its neighbours.
        """
        timer = f"setTimeout(show_seen, {after})" if every is None else f"setInterval(show_seen, {every})"
        write = f"""<script>{{ const show_seen = () => {{
          const out = document.getElementById("seen") || document.createElement("pre"); out.id = "seen";
          out.style.cssText = "position: absolute; width: 0; height: 0; overflow: hidden";  // takes no room
          out.textContent = JSON.stringify({probe}); document.body.append(out); }}; {timer}; }}</script></body>"""
        shown = file or tmp_path / "page.html"
        shown.write_text(page[: page.rindex("</body>")] + write, encoding="utf-8")
        if width < 500:
            frame = f'<iframe src="{shown.as_uri()}" width="{width}" height="800"></iframe>'
            copy = """<script>setInterval(() => {
              const seen = document.querySelector("iframe").contentDocument.getElementById("seen");
              if (seen) document.body.append(seen); }, 100);</script>"""
            opened = tmp_path / "narrow.html"
            opened.write_text(f"<html><body>{frame}{copy}</body></html>", encoding="utf-8")
        else:
            opened = shown
        own = ["--allow-file-access-from-files", "--disable-background-networking", "--disable-component-update"]
        size = [f"--window-size={max(width, 900)},{900 if width < 500 else 600}", "--hide-scrollbars"]
        time = f"--virtual-time-budget={after + 5500}"
        command = [BROWSER, "--headless", "--no-sandbox", time, *own, *size, *options]
        call = [*command, f"--user-data-dir={tmp_path}/profile", "--dump-dom", opened.as_uri()]
        done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
        found = re.findall(r'<pre id="seen"[^>]*>(.*?)</pre>', done.stdout, re.S)
        assert found, done.stderr[-500:]
        return json.loads(html.unescape(found[-1]))

    return look
