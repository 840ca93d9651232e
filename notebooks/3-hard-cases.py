# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 3. Hard cases
#
# A simulator is judged by the runs in which others stop. This notebook has four of them: a link that hangs straight
# down, friction that stops a motion, a step that is far too long, and a mass ratio of a thousand.

# %%
import matplotlib.pyplot as plt
import numpy as np

import dropper_jax as dj
from dropper_jax.plots import style

plt.rcParams.update(style.RC | {"figure.dpi": 90})


def chain(links, length, mass, start, effects, dt, duration):
    """A chain with a free end."""
    return {
        "run": {"dt": dt, "duration": duration},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [float(np.sum(length)), 0.0, 0.0]},
        ],
        "line": [{"name": "line", "from": "top", "to": "end", "links": links, "length": length, "mass": mass}],
        "effects": effects,
        "start": start,
    }


# %% [markdown]
# ## Straight down
#
# In spherical angles a vertical link has no azimuth. The equations of the thesis divide by `cos(theta)`, and their
# matrix is singular exactly where a dropper hangs. Here a pendulum is released so that it swings through the vertical,
# with a sideways speed that brings it ever closer to it. Nodes and tensions are not affected; the angles of the thesis
# are.

# %%
rows = []
for sideways in (0.3, 1e-2, 1e-4, 1e-6):
    start = {"kind": "angles", "zero": "down", "polar": [1.0], "polar_rate": [0.0], "azimuth_rate": [sideways]}
    scene = chain(1, 1.0, 1.0, start, {"weight": {}}, 0.005, 2.0)
    for name, gamma in (("energy_momentum", None), ("thesis_angles", 0.51)):
        run = dj.simulate(scene, integrator=name, gamma=gamma)
        nearest = np.hypot(run.positions[:, 1, 0], run.positions[:, 1, 1]).min()
        rows.append((sideways, name, run.status, nearest, run.energy_drift / run.energy_scale))
print(f"{'sideways [rad/s]':>16s} {'scheme':>16s} {'status':>14s} {'nearest [m]':>12s} {'energy lost or won':>20s}")
for sideways, name, status, nearest, drift in rows:
    print(f"{sideways:16.0e} {name:>16s} {status:>14s} {nearest:12.1e} {drift:20.1e}")

# %% [markdown]
# ## Friction that stops
#
# Dry friction is a set-valued law, not a steep curve: a joint that sticks transmits any torque up to its limit. A
# pendulum with a dry pivot loses an amplitude of `4 tau/(m g L)` per swing, at a constant rate, and then stands still,
# inclined. A smooth approximation (a steep `tanh`) would creep down indefinitely.

# %%
TAU, MASS, LENGTH = 0.05, 1.0, 0.5
start = {"kind": "angles", "zero": "down", "polar": [0.25]}
dry = chain(1, LENGTH, MASS, start, {"weight": {}, "joint_friction": {"dry": [TAU, 0.0]}}, 0.005, 16.0)
wet = chain(1, LENGTH, MASS, start, {"weight": {}, "linear_damping": {"b_l": 0.12}}, 0.005, 16.0)
stops, never = dj.simulate(dry), dj.simulate(wet)
angle, other = (np.pi / 2 - run.polar[:, 0] for run in (stops, never))
per_cycle = 4 * TAU / (MASS * 9.81 * LENGTH)
period = 2 * np.pi * np.sqrt(LENGTH / 9.81)
fig, ax = plt.subplots(figsize=(9, 3.4))
ax.plot(never.t, other, color=style.FAINT, lw=1, label="linear damping: never stops")
ax.plot(stops.t, angle, color=style.FIRST, label="dry pivot")
ax.plot(
    stops.t,
    np.clip(0.25 - per_cycle * stops.t / period, 0, None),
    color=style.SECOND,
    ls="--",
    label="theory: straight line",
)
ax.set(xlabel="time [s]", ylabel="angle [rad]", xlim=(0, 16))
ax.legend(loc="upper right")
plt.show()
late = stops.t > 12
print(f"over the last 4 s the dry pendulum stands at {angle[-1]:+.4f} rad and creeps by {np.ptp(angle[late]):.0e} rad")
print(f"it can stand anywhere within {TAU / (MASS * 9.81 * LENGTH):.4f} rad")

# %% [markdown]
# ## Steps that are too long
#
# The lab dropper's links swing with a period of about 0.65 s, and its joints jerk within hundredths of that. What
# happens at steps that are too long for it? Each run reports the result: steps that did not converge are tried again
# with a better solver, then halved, and counted. Any remaining failure is reported. The energy balance shows whether
# the result is meaningful.

# %%
lab = dj.load_scene("dropper-release-a")
head = ("step [s]", "status", "retried", "of steps", "maximum residual", "energy drift [J]")
widths = (9, 15, 8, 9, 17, 17)
print(" ".join(f"{text:>{width}s}" for text, width in zip(head, widths, strict=True)))
for dt in (0.005, 0.01, 0.02, 0.04, 0.06, 0.08):
    run = dj.simulate(lab, dt=dt, duration=4 * dt * 25)
    cells = (f"{dt:.3f}", run.status, str(run.retried_steps), str(run.settings["steps"]))
    cells += (f"{run.max_residual:.0e}", f"{run.energy_drift:.0e}")
    print(" ".join(f"{text:>{width}s}" for text, width in zip(cells, widths, strict=True)))

# %% [markdown]
# ## A heavy end on a light line
#
# The upper links have 0.1 % of the mass at the lower end: an anchor on a fishing line. Schemes with springs for links
# need tiny steps here, because the light nodes vibrate between the heavy ones. With tensions as unknowns nothing
# vibrates.

# %%
masses = [0.001] * 9 + [1.0]
inclined = {"kind": "angles", "zero": "down", "polar": [1.2] * 10}
run = dj.simulate(chain(10, 0.1, masses, inclined, {"weight": {}}, 0.004, 6.0))
fig, axes = plt.subplots(1, 2, figsize=(9.5, 4.0), layout="constrained", gridspec_kw={"width_ratios": [1, 1.3]})
for i in range(0, len(run.t), max(1, len(run.t) // 40)):
    shade = 0.15 + 0.8 * i / len(run.t)
    axes[0].plot(run.positions[i, :, 0], run.positions[i, :, 2], color=plt.cm.Blues(shade), lw=1)
axes[0].set(aspect="equal", xlabel="x [m]", ylabel="z [m]", title="forty instants, light to dark")
axes[1].plot(run.t_tension[1:], run.tension[1:, 0], color=style.FIRST, lw=1)
# a pendulum of 1 m: T = m g cos(a) + m v^2/L, with v^2 from its height
height = run.positions[:, -1, 2]
simple = 9.81 * -height + 2 * 9.81 * (height[0] - height)
axes[1].plot(run.t, simple, color=style.SECOND, ls="--", lw=1, label="one stiff pendulum of 1 m")
axes[1].set(xlabel="time [s]", ylabel="tension at the top [N]", xlim=(0, run.t[-1]))
axes[1].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0))
plt.show()
print(f"{run.status}; energy drifts by {run.energy_drift:.0e} J of {run.energy_scale:.1f} J")
print(f"links are off their length by {run.max_closure_error:.0e} m at most")
