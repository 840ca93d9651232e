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
# # 1. First dropper
#
# A mussel dropper is a rope of mussels that hangs as a loop between two points of a longline. The laboratory model had
# seven bars, 73 cm in total, pinned to each other and to two hooks 28 cm apart. One node was lifted with a fishing
# line, the line was cut, and a camera recorded the motion. This notebook does the same on the computer: it hangs the
# loop, lifts it, and releases it.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import dropper_jax as dj
from dropper_jax import plots, statics
from dropper_jax.plots import style, tension_colours

plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## Hang it, lift it
#
# The scene `dropper-release-a` is packaged. It defines the links, the weight, the damping, and the force that lifts
# node 1. Without that force the loop hangs like a chain; with it, it takes the configuration before the release.

# %%
scene = dj.load_scene("dropper-release-a")
model, start = dj.build(scene)
at_rest = statics.equilibrium(model)
lifted = np.vstack([[0, 0, 0], start.r, [0.28, 0, 0]])

fig, ax = plt.subplots(figsize=(6.4, 4.2))
for nodes, colour, label in ((at_rest.positions, style.FAINT, "at rest"), (lifted, style.FIRST, "lifted at node 1")):
    ax.plot(nodes[:, 0], nodes[:, 2], "-o", color=colour, label=label, ms=6, mfc="white", lw=2)
ax.annotate("lifted here", lifted[1, [0, 2]], (10, 2), textcoords="offset points", color=style.SECOND)
ax.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="The lab dropper before its release")
ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
plt.show()

# %% [markdown]
# Does the laboratory agree? The link angles before the release were measured in three runs. The mean of the
# measurements against the static pose, link by link:

# %%
table = Path(dj.__file__).parent / "data" / "release_angles_rad.csv"
measured = np.genfromtxt(table, delimiter=",", dtype=str)
runs = np.array([row[2:].astype(float) for row in measured if row[0] == "A" and row[1] != "model"])
links = np.diff(lifted, axis=0)
pose = np.arctan2(-links[:, 2], links[:, 0])
print("link      " + "".join(f"{j:9d}" for j in range(1, 8)))
print("measured  " + "".join(f"{x:9.3f}" for x in runs.mean(axis=0)))
print("computed  " + "".join(f"{x:9.3f}" for x in pose))
print(f"\nRMS difference {np.sqrt(np.mean((pose - runs.mean(axis=0)) ** 2)):.4f} rad")

# %% [markdown]
# ## Release
#
# One call runs the simulation. The result reports whether it can be trusted: every step converged, and energy plus the
# work of the damping equals its initial value to rounding.

# %%
solution = dj.simulate(scene, duration=20.0)
print(f"status            {solution.status}")
print(f"failed steps      {solution.failed_steps}, retried {solution.retried_steps}")
print(f"energy balance    drifts by {solution.energy_drift:.0e} J of {solution.energy_scale:.2f} J")
weight = 9.81 * scene.lines[0].mass.sum()
print(f"maximum tension   {solution.tension.max():.2f} N; the whole dropper weighs {weight:.2f} N")

# %%
fig, axes = plt.subplots(2, 5, figsize=(9.5, 4.0), sharex=True, sharey=True, layout="constrained")
norm = tension_colours.tension_norm(solution.tension)
for ax, when in zip(axes.flat, np.arange(10) * 0.11, strict=True):
    i = np.searchsorted(solution.t, when)
    x, _, z = solution.positions[i].T
    for j in range(7):
        colour = tension_colours.tension_map()(norm(solution.tension[i, j]))
        ax.plot(x[j : j + 2], z[j : j + 2], color=colour, lw=3.5, solid_capstyle="round")
    ax.plot(x, z, "o", color="white", mec=style.DARK, ms=3.5, mew=0.7)
    ax.set(title=f"{when:.2f} s", aspect="equal")
for ax in axes[:, 0]:
    ax.set_ylabel("z [m]")
for ax in axes[1]:
    ax.set_xlabel("x [m]")
bar = fig.colorbar(plt.cm.ScalarMappable(norm, tension_colours.tension_map()), ax=axes, shrink=0.9)
bar.set_label("tension [N]")
plt.show()

# %% [markdown]
# The first second, coloured by tension: the lifted corner falls, and the motion travels along the loop and returns.
# Each packaged picture is one call.

# %%
Image(plots.angle_traces(solution, "angles.png").read_bytes(), width=720)

# %%
Image(plots.energy_balance(solution, "energy.png").read_bytes(), width=620)

# %% [markdown]
# ## The same again, almost
#
# Two releases differ by 0.01 % of the lifting force. For four seconds the motions agree, then they diverge: a dropper
# is chaotic. This is not an error of the computation, whose energy balance closes to rounding. It is the reason why
# laboratory runs also differ, and why damping cannot be estimated by eye from a long trace (notebook 4). Over long
# times, only statistics are meaningful.

# %%
force = 1.0001 * np.asarray(scene.start.release_force)
twin = dj.simulate(scene.with_values({"start.release_force": force.tolist()}), duration=20.0)
apart = np.sqrt(np.mean(np.abs(np.exp(1j * twin.polar) - np.exp(1j * solution.polar)) ** 2, axis=1))
fig, axes = plt.subplots(2, 1, figsize=(8, 4.6), sharex=True)
axes[0].plot(solution.t, solution.polar[:, 2], color=style.FIRST, label="release")
axes[0].plot(twin.t, twin.polar[:, 2], color=style.SECOND, lw=0.9, label="force 0.01 % larger")
axes[0].set(ylabel="angle of link 3 [rad]")
axes[0].legend(loc="upper right", ncols=2)
axes[1].semilogy(solution.t, apart, color=style.DARK)
axes[1].set(ylabel="RMS difference [rad]", xlabel="time [s]", xlim=(0, solution.t[-1]))
plt.show()
