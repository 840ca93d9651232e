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
# # 6. Many droppers at once
#
# One run answers a question about one dropper. A design needs a map: how do tension and excursion depend on the
# damping, which is uncertain, and on the sea, which varies? The simulator runs batches: one compilation, 64 droppers in
# parallel on each core. Results are stored chunk by chunk, so that nothing is lost if the machine stops.

# %%
import matplotlib.pyplot as plt
import numpy as np

import dropper_jax as dj
from dropper_jax.plots import style, tension_colours
from fitting.sweep import open_sweep, sweep

plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## Damping
#
# The lab dropper is released for a grid of both damping coefficients. `open_sweep` gives an xarray dataset with the
# inputs as coordinates, including names and units.

# %%
lab = dj.load_scene("dropper-release-a")
lab = lab.with_values({"run.duration": 10.0, "run.integrator": "rattle"})
b_l = np.geomspace(0.0005, 0.02, 24)
b_q = np.linspace(0.0, 0.01, 20)
done = sweep(lab, {"b_l": b_l, "b_q": b_q}, "damping.zarr")
print(f"{done.cases} runs of {lab.run.duration:g} s, {done.steps} steps each: {done.counts['ok']} ok")
found = open_sweep("damping.zarr").load()
for name, values in found.data_vars.items():
    print(f"  {name:14s} {values.attrs.get('long_name', '')} [{values.attrs.get('units', '-')}]")

# %%
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
pictured = {"excursion": "maximum excursion of a node [m]", "energy_final": "energy at the end, above the minimum [J]"}
for ax, (name, label) in zip(axes, pictured.items(), strict=True):
    level = np.asarray(found[name])
    if name == "energy_final":
        level = level - level.min()  # the zero of the potential energy is arbitrary
    mesh = ax.pcolormesh(b_l, b_q, level.T, cmap=tension_colours.tension_map(), shading="gouraud")
    ax.set(xscale="log", title=label)
    ax.set(xlabel="linear damping b_l [kg/s]", ylabel="quadratic damping b_q [kg/m]")
    ax.grid(False)
    fig.colorbar(mesh, ax=ax)
plt.show()

# %% [markdown]
# Energy depends smoothly on the damping, as expected for a sum over the whole motion. A maximum over a chaotic motion
# does not: patches in the corner of small damping are not errors but a property of the dropper. For such quantities,
# use many runs and their scatter, never a single run.

# %% [markdown]
# ## Sea state
#
# A dropper of 17 m hangs 6 m below the surface. The sea becomes rougher from left to right. For each sea state there
# are several seas: the same spectrum with other random phases. The argument `seeds` sets their number.

# %%
waves = {"kind": "spectrum", "spectrum": "jonswap", "hs": 2.0, "tp": 9.0, "gamma": 3.3, "count": 16, "seed": 1}
loop = {"name": "dropper", "from": "left", "to": "right", "links": 9, "length": 17 / 9, "mass": 40.0, "diameter": 0.15}
ocean = {
    "description": "A looped dropper of 17 m below a random sea, water 30 m deep",
    "run": {"dt": 0.05, "duration": 60.0},
    "point": [{"name": "left", "position": [0.0, 0.0, -6.0]}, {"name": "right", "position": [2.5, 0.0, -6.0]}],
    "line": [loop],
    "sea": {"depth": 30.0, "waves": waves},
    "effects": {
        "weight": {},
        "buoyancy": {},
        "morison_drag": {"cdn": 1.4, "cdt": 0.02},
        "morison_inertia": {"can": 1.0, "cat": 0.0},
    },
}
heights = np.arange(0.5, 4.1, 0.5)
drag = np.array([0.7, 2.8])
paths = {"sea.waves.hs": heights, "effects.morison_drag.cdn": drag}
done = sweep(ocean, paths, "sea.zarr", seeds=10)
print(f"{done.cases} runs: {done.counts['ok']} ok")
sea = open_sweep("sea.zarr").load()
print({str(name): size for name, size in sea.sizes.items()})

# %%
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
pictured = {"tension_max": "maximum tension [N]", "excursion": "maximum excursion of a node [m]"}
for ax, (name, label) in zip(axes, pictured.items(), strict=True):
    values = np.asarray(sea[name]).reshape(len(heights), len(drag), -1)
    for k, cd in enumerate(drag):
        cases = values[:, k]
        ax.plot(heights, cases.mean(axis=1), "-o", color=style.CYCLE[k], ms=4, label=f"drag coefficient {cd:g}")
        ax.fill_between(heights, cases.min(axis=1), cases.max(axis=1), color=style.CYCLE[k], alpha=0.15, lw=0)
    ax.set(xlabel="significant wave height [m]", ylabel=label)
axes[0].legend(title="mean and range over seas")
plt.show()

# %% [markdown]
# The band shows the effect of the random phases at one sea state. A single run lies somewhere in the band: it may be
# the mildest or the worst of a dozen seas.
