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
# # 2. What accuracy costs
#
# A smaller time step gives a better answer and takes longer. How much better, and how much longer? The answer depends
# on the scheme, and it decides whether a result comes from the dropper or from the program. This notebook measures it
# on the laboratory dropper: seven links, released from the pose of scenario A.
#
# The measure is the RMS error of all link angles relative to a reference with a much finer step. It is taken over the
# time for which errors are meaningful: a dropper is chaotic, so later any two answers differ. Time is wall time per
# simulated second.

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import dropper_jax as dj
from dropper_jax.plots import style
from dropper_jax.study import accuracy_pictures
from dropper_jax.study.accuracy import accuracy
from dropper_jax.study.schemes import parse

plt.rcParams.update(style.RC | {"figure.dpi": 90})


# %%
scene = dj.load_scene("dropper-release-a")
names = ["energy_momentum", "rattle", "theta:0.51", "theta:1", "theta_midpoint:0.51", "energy_momentum_4"]
steps = tuple(2.0**-k for k in range(5, 12))  # 1/32 to 1/2048 s
found = accuracy(scene, [parse(name) for name in names], steps, span=2.0, extras=False)
print("order of each scheme, from the slope of its errors:")
for label, order in found["orders"].items():
    print(f"  {label:28s} {order:.2f}" if order is not None else f"  {label:28s} -")

# %%
Image(accuracy_pictures.work_precision(found, "work-precision.png").read_bytes(), width=860)

# %% [markdown]
# Use the left picture to choose: lower is better, further left is faster. (Times jump where the machine had other work;
# errors do not depend on it.) `rattle` is the cheapest good scheme for links of point masses. `energy_momentum`
# supports everything else: compound bars, friction, elastic lines, water. Below an error of 0.01 %, use the
# fourth-order composition. A missing dot is a run that diverged or did not converge. `theta 0.51` is the scheme of the
# thesis; at the thesis' own step of 0.0065 s it does not survive this release. For an error of 1 % it needs steps
# several times shorter than the default.

# %% [markdown]
# ## Which step should I use?
#
# This table answers the question, from the measurements above:

# %%
for line in found["advice"]:
    print(line["text"])

# %% [markdown]
# ## What happens to the energy
#
# Release the dropper without any damping. Its energy should be constant. Three schemes at the same step:

# %%
plain = scene.with_values({"effects.linear_damping.b_l": 0.0, "effects.quadratic_damping.b_q": 0.0})
choices = [("energy_momentum", None), ("rattle", None), ("theta", 1.0)]
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
for (name, gamma), colour in zip(choices, style.CYCLE, strict=False):
    run = dj.simulate(plain, dt=0.005, duration=6.5, integrator=name, gamma=gamma)
    label = name if gamma is None else f"{name} {gamma:g} (implicit Euler)"
    energy = run.kinetic + run.potential - (run.kinetic + run.potential)[0]
    axes[0].plot(run.t, 1e3 * energy, color=colour, label=label)
    axes[1].semilogy(run.t[1:], np.abs(energy[1:]) + 1e-18, color=colour, lw=0.8)
axes[0].set(xlabel="time [s]", ylabel="change of energy [mJ]", title="to scale: 75 mJ were put in")
axes[1].set(xlabel="time [s]", ylabel="|change of energy| [J]", title="the same, logarithmic")
axes[0].legend()
plt.show()

# %% [markdown]
# Implicit Euler dissipates the motion. On a trace this looks like damping, and a damping coefficient fitted with it
# describes the scheme. The default scheme conserves energy to rounding, so all losses come from the dropper.
