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
# # 7. A dropper in a storm
#
# The thesis studies the effect of the 25-year storm on a dropper in the North Sea: 17 m of mussels, hung as a loop
# between two points 2.5 m apart. It states a significant wave height of 8.20 m and prints the 231 wave components that
# it used. The components disagree with this height, as the first section shows.

# %%
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import dropper_jax as dj
from dropper_jax import plots
from dropper_jax.plots import style
from dropper_jax.study.flow_regime import regime

plt.rcParams.update(style.RC | {"figure.dpi": 90})
SECONDS = 120.0

# %% [markdown]
# ## Two seas
#
# Significant wave height is four times the standard deviation of the surface, `Hs = 4 sqrt(sum a^2/2)`. From the
# printed amplitudes that is 2.6 m, not 8.2 m. So there are two packaged seas: the components as printed, and a
# JONSWAP sea of the stated height and period.

# %%
table = Path(dj.__file__).parent / "data" / "seas" / "north_sea_25_year_components.csv"
printed = np.genfromtxt(table, delimiter=",", names=True)
period, amplitude = (printed[name] for name in printed.dtype.names[:2])
print(f"{len(period)} components, Hs = {4 * np.sqrt(np.sum(amplitude**2) / 2):.2f} m")
fig, ax = plt.subplots(figsize=(7.5, 2.8))
ax.vlines(1 / period, 0, amplitude, color=style.FIRST, lw=0.8)
ax.set(xlabel="frequency [Hz]", ylabel="amplitude [m]", ylim=(0, None), title="the thesis' wave components")
plt.show()

# %% [markdown]
# ## The dropper
#
# The ends are fixed at the mean surface, as in the thesis, so that the upper links emerge in every trough: buoyancy and
# drag depend on the wet fraction of a link. The hydrodynamic forces follow Morison.

# %%
scene = dj.load_scene("dropper-north-sea")
mild = dj.simulate(scene, duration=SECONDS)
print(f"{mild.status}: {mild.failed_steps} failed steps, {mild.retried_steps} tried again")
for name, value in regime(mild).items():
    if isinstance(value, float):
        print(f"  {name}: {value:.3g}")

# %%
Image(plots.under_surface(mild, "under.png").read_bytes(), width=760)

# %%
Image(plots.response(mild, "response.png").read_bytes(), width=760)

# %% [markdown]
# Top: the surface. Middle: spectra of the response of a link in the loop. Bottom: its two angles in phase space.
#
# The components show something else: their phases coincide at the start. The printed sea starts with one wave of nine
# metres from crest to trough and is quiet afterwards, so that all notable events of this run occur in its first ten
# seconds. It is a good test wave and a poor storm.
#
# ## The stated storm
#
# The same dropper in the sea that the thesis states, Hs 8.20 m with a peak period of 11.7 s, compared with the printed
# components:

# %%
# the same scene file with another packaged sea
values = tomllib.loads((Path(dj.__file__).parent / "data" / "scenes" / "dropper-north-sea.toml").read_text())
values |= {"name": "dropper-in-the-stated-storm", "sea": {"packaged": "north-sea-25-year-jonswap"}}
storm = dj.simulate(values, duration=SECONDS)
print(f"{storm.status}: {storm.failed_steps} failed steps, {storm.retried_steps} tried again")


def pairs(tension):
    """Means of neighbouring steps, in which what alternates from step to step cancels."""
    return 0.5 * (tension[1:] + tension[:-1])


both = ((storm, "as stated, Hs 8.20 m", style.SECOND), (mild, "as printed, Hs 2.57 m", style.FIRST))
fig, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
for run, label, colour in both:
    node = run.positions[:, 9]
    axes[0].plot(run.t, np.hypot(node[:, 0] - 1.25, node[:, 1]), color=colour, lw=1, label=label)
    largest = run.tension[1:].max(axis=1)
    axes[1].plot(run.t_tension[1:], largest, color=colour, lw=0.6, alpha=0.3)
    axes[1].plot(run.t_tension[2:], pairs(largest), color=colour, lw=0.9)
axes[0].set(ylabel="node 9, sideways [m]")
axes[1].set(ylabel="maximum tension [N]", xlabel="time [s]", xlim=(0, SECONDS))
axes[0].legend(loc="upper right", ncols=2)
plt.show()

# %% [markdown]
# In the storm the loop is thrown up and caught: at 44 and 54 s it falls back into its ropes. After such a jerk the
# tension of a rigid link alternates from step to step (pale), because the model has no damping along the rope. Motions,
# and means over two steps (dark), are not affected. For the peak of a jerk a rigid link is the wrong model: give the
# line an `EA` and internal damping, and use shorter steps. The usual load does not depend on that:

# %%
line = scene.lines[0]
weight = 9.81 * (line.mass - 1000 * np.pi / 4 * 0.05**2 * line.length).sum()
fig, ax = plt.subplots(figsize=(7.5, 3.2))
for run, label, colour in both:
    top = np.sort(pairs(run.tension[1:, [0, -1]]).max(axis=1))[::-1]
    ax.semilogy(top, np.arange(1, len(top) + 1) / len(top), color=colour, label=label)
ax.axvline(weight / 2, color=style.FAINT, ls="--", lw=1)
ax.text(weight / 2 + 20, 0.3, "half of its weight in water", color="#5F6368")
ax.set(xlabel="larger of the tensions at the two ends [N]", ylabel="fraction of time above", ylim=(1e-3, 1))
ax.legend()
plt.show()
print(f"maximum tension: {pairs(mild.tension).max():.0f} N as printed, {pairs(storm.tension).max():.0f} N as stated")

# %%
Image(plots.tension_envelope(storm, "envelope.png").read_bytes(), width=640)

# %% [markdown]
# The picture shows how far down the rope the load reaches, and where it becomes zero or negative. Links are rigid here
# and may transmit compression; a rope cannot. A negative tension means that this rope would go slack and then jerk.
