"""How time grows with links and with droppers at once, on one and two host devices.

    python benchmarks/scaling.py          (about 3 minutes)

Microseconds per step from 7 to 10 000 links, and link-steps per second from 1 to 4096 droppers of 7 links. Writes
results/scaling.json and results/scaling.png beside this file.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
LINKS = (7, 18, 50, 100, 300, 1000, 3000, 10000)
BATCHES = (1, 4, 16, 64, 256, 1024, 4096)
#: Droppers simulated together: more would leave the processor's cache.
CHUNK = 64
SCHEMES = ("energy_momentum", "rattle")
REPEATS = 4


def step_of(links: int) -> float:
    """Step [s]: the fold of the pose that the line starts from accelerates in proportion to the links it carries."""
    return 0.005 / links**0.5


def least(run: Any) -> float:
    """Least wall time [s] of a compiled run: other load on the machine only ever adds."""
    import jax

    jax.block_until_ready(run())
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - begun)
    return min(times)


def line_of(links: int) -> tuple[Any, Any]:
    """A loop of `links` links of 0.1 m in its hanging pose, a little displaced, and its state."""
    import jax.numpy as jnp
    import numpy as np

    import dropper_jax as dj

    total, width = 0.1 * links, 0.05 * links
    scene = dj.load_scene(
        {
            "name": "scaling",
            "run": {"dt": 0.005, "duration": 1.0},
            "point": [
                {"name": "left", "position": [0.0, 0.0, 0.0]},
                {"name": "right", "position": [width, 0.0, 0.0]},
            ],
            "line": [{"name": "line", "from": "left", "to": "right", "links": links, "length": 0.1, "mass": 0.03}],
            "effects": {"weight": {}},
            "start": {"kind": "positions", "positions": _zigzag(links, width).tolist()},
        }
    )
    assert abs(float(np.sum(scene.lines[0].length)) - total) < 1e-9
    model, s = dj.build(scene)
    return model, dj.state(model, s.r, jnp.zeros_like(s.r))


def _zigzag(links: int, width: float) -> Any:
    """A closed polygon of links of 0.1 m: down at a slope, then up, its lowest link level where the number is odd."""
    import numpy as np

    half = links // 2
    level = 0.1 * (links % 2)
    across = (width - level) / (2 * half)
    drop = np.sqrt(0.01 - across**2)
    steps = [[across, 0.0, -drop]] * half + [[level, 0.0, 0.0]] * (links % 2) + [[across, 0.0, drop]] * half
    places = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    places[-1] = [width, 0.0, 0.0]
    return places


def by_links() -> list[dict[str, Any]]:
    """Microseconds per step of one line."""
    from functools import partial

    import jax

    import dropper_jax as dj

    rows = []
    for links in LINKS:
        model, s = line_of(links)
        steps = max(10, 20000 // links)
        for scheme in SCHEMES:
            stepper = dj.make_stepper(model, scheme, extra=0, halvings=0)  # the plain step; its residual stands beside
            run = jax.jit(partial(dj.integrate, stepper, dt=step_of(links), steps=steps, save_every=steps))
            us = 1e6 * least(partial(run, model, s)) / steps
            residual = float(run(model, s)[1].residual[-1])
            row = {"scheme": scheme, "links": links, "us_per_step": us, "us_per_link_step": us / links}
            rows.append({**row, "residual": residual})
            print(f"  {scheme:16s} {links:6d} links  {us:10.2f} us per step, residual {residual:.0e}", flush=True)
    return rows


def by_batch(devices: int) -> list[dict[str, Any]]:
    """Link-steps per second of many droppers; chunks of `CHUNK` one after another, shared out to the devices."""
    from functools import partial

    import jax
    import jax.numpy as jnp

    import dropper_jax as dj
    from dropper_jax.lanes import lanes

    model, s = line_of(7)
    rows = []
    for scheme in SCHEMES:
        stepper = dj.make_stepper(model, scheme, extra=0, halvings=0)
        for count in BATCHES:
            if count < devices:
                continue
            per, steps = count // devices, max(10, 8000 // count)
            shape = (devices, max(1, per // CHUNK), min(per, CHUNK))

            def chunk(v: Any, stepper: Any = stepper, steps: int = steps) -> Any:
                def run(x: Any) -> Any:
                    return dj.integrate(stepper, model, dj.state(model, s.r, x), 0.002, steps, steps)[0].r

                return lanes(run)(v)

            whole = jax.pmap(partial(jax.lax.map, chunk))
            v = 0.01 * jax.random.normal(jax.random.key(0), (*shape, *s.r.shape))
            seconds = least(partial(whole, jnp.asarray(v)))
            rate = 7 * count * steps / seconds
            rows.append({"scheme": scheme, "devices": devices, "droppers": count, "link_steps_per_s": rate})
            print(f"  {scheme:16s} {count:5d} droppers, {devices} devices  {rate:.3g} link-steps per s", flush=True)
    return rows


def child(what: str, devices: int) -> list[dict[str, Any]]:
    """Rows measured in a process of its own, whose number of host devices is set before JAX starts."""
    flags = f"--xla_force_host_platform_device_count={devices} --xla_cpu_multi_thread_eigen=false"
    environment = {**os.environ, "XLA_FLAGS": flags, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, __file__, what, str(devices)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    *lines, rows = done.stdout.splitlines()
    print("\n".join(lines), flush=True)
    return json.loads(rows)


def draw(found: dict[str, Any], path: Path) -> Path:
    """Microseconds per step against links, and link-steps per second against droppers at once, log-log."""
    from dropper_jax.plots import style
    from dropper_jax.study.pictures import marks, title

    with style.look():
        figure = style.new_figure(11.0, 4.6)
        left, right = figure.subplots(1, 2)
        for i, scheme in enumerate(dict.fromkeys(row["scheme"] for row in found["by_links"])):
            rows = [row for row in found["by_links"] if row["scheme"] == scheme]
            left.plot([r["links"] for r in rows], [r["us_per_step"] for r in rows], label=scheme, **marks(i))
        left.set(xscale="log", yscale="log", xlabel="links", ylabel="microseconds per step")
        left.legend()
        kinds = dict.fromkeys((row["scheme"], row["devices"]) for row in found["by_batch"])
        for i, (scheme, devices) in enumerate(kinds):
            rows = [r for r in found["by_batch"] if (r["scheme"], r["devices"]) == (scheme, devices)]
            label = f"{scheme}, {devices} device{'s' if devices > 1 else ''}"
            right.plot([r["droppers"] for r in rows], [r["link_steps_per_s"] for r in rows], label=label, **marks(i))
        right.set(xscale="log", yscale="log", xlabel="droppers of 7 links at once", ylabel="link-steps per second")
        right.legend()
        title(figure, "scaling with links and with droppers at once")
        return style.save(figure, path)


def main() -> int:
    if len(sys.argv) > 1:
        devices = int(sys.argv[2])
        print(json.dumps(by_links() if sys.argv[1] == "links" else by_batch(devices)))
        return 0

    from importlib import metadata

    from machine import describe

    from dropper_jax.base.files import atomic_write

    RESULTS.mkdir(exist_ok=True)
    rows = {"by_links": child("links", 1), "by_batch": child("batch", 1) + child("batch", 2)}
    versions = {name: metadata.version(name) for name in ("jax", "jaxlib", "dropper-jax")}
    found = {"schema": 1, "machine": describe(), "versions": versions, "chunk": CHUNK, **rows}
    atomic_write(RESULTS / "scaling.json", json.dumps(found, indent=1) + "\n")
    draw(found, RESULTS / "scaling.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
