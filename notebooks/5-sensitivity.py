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
# # 5. What matters
#
# A designer asks which parameters determine the maximum tension. This notebook gives three answers, each with its
# limits: exact derivatives at a point, the time up to which they are valid, and indices over whole ranges.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

import dropper_jax as dj
from dropper_jax.plots import style
from fitting import sensitivity
from fitting.sensitivity import tornado

plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## Derivatives
#
# The lab dropper is released, and the quantity is the maximum tension of the first second. Its derivative with respect
# to every damping coefficient and mass comes from one run. It is exact: it uses the equations of each step, not
# differences of runs. Scaled, it is the percentage change of the tension for a 1 % change of the parameter.

# %%
scene = dj.load_scene("dropper-release-a").with_values({"run.integrator": "rattle", "run.duration": 1.0})
names = ["b_l", "b_q", "gravity", *(f"line.0.mass.{j}" for j in range(6))]
problem = sensitivity.study(scene, "tension.max", names)
found = sensitivity.local_derivatives(problem, check=True)
print(f"{found.of} = {found.value:.3f} {found.unit}; forward and reverse mode differ by {found.mismatch:.0e}")
tornado.local_picture(found, "tornado.png")
Image("tornado.png", width=640)

# %% [markdown]
# Gravity leads, but with an unexpected sign: does more weight give less tension? The scene lifts the dropper with a
# constant force. A heavier dropper is lifted less, falls less, and jerks less. The derivative covers the whole
# computation, including the static pose before the release. The masses next to the lifted node have most of the effect,
# the last ones none; damping hardly matters for the first jerk.
#
# Are these numbers right? A difference quotient, which needs two more runs per number, should agree:

# %%
value = jax.jit(problem)
at = jnp.asarray(problem.values)
for i, name in list(enumerate(problem.names))[:3]:
    step = jnp.zeros_like(at).at[i].set(1e-5 * max(float(at[i]), 1e-3))
    quotient = float((value(at + step) - value(at - step)) / (2 * step[i]))
    print(f"{name:28s} exact {float(found.forward[i]):+.8f}   difference quotient {quotient:+.8f}")

# %% [markdown]
# ## How far in time
#
# The dropper is chaotic: a small change grows. So does a derivative. A derivative of a hundred thousand is exact but
# useless, because it holds only for changes that are too small to matter. The next picture shows the derivative of the
# final position of node 3, for runs of growing length:

# %%
lengths = np.array([0.5, 1, 2, 4, 8, 12])
sizes = []
for length in lengths:
    part = scene.with_values({"run.duration": float(length)})
    one = sensitivity.study(part, "x.3.final", ["b_l"])
    sizes.append(abs(float(jax.jit(jax.jacfwd(one))(jnp.asarray(one.values))[0])))
telling = 0.003 / (0.01 * 0.002)
fig, ax = plt.subplots(figsize=(7.5, 3.2))
ax.semilogy(lengths, sizes, "o-", color=style.FIRST)
ax.axhline(telling, color=style.SECOND, ls="--", lw=1)
ax.text(lengths[0], 1.3 * telling, "1 % of b_l moves the node by 3 mm", color=style.SECOND)
ax.set(xlabel="length of the run [s]", ylabel="|d x_3 / d b_l|  [m s/kg]")
plt.show()
print(f"growth rate {found.exponent:.2g} per s: derivatives are trusted for {found.horizon:.2g} s")

# %% [markdown]
# Beyond that horizon `dropper sensitivity` gives averages over windows instead. For statistical questions, use ranges:
#
# ## Over ranges
#
# Sobol's indices divide the variance of a result among its causes: the part that each explains alone (first), and
# the part with all combinations that contain it (total). They need thousands of runs and no derivative. The example is
# the swing of link 4, at the bottom, over ten seconds (standard deviation of its angle), over the ranges that a
# laboratory may find. In a batch, the runs take seconds.

# %%
longer = scene.with_values({"run.duration": 10.0})
ranged = sensitivity.study(longer, "angle.4.std", ["b_l", "b_q", "line.0.mass.2"])
box = sensitivity.parameter_ranges(
    ranged, {"b_l": (0.0005, 0.008), "b_q": (0.0, 0.006), "line.0.mass.2": (0.030, 0.036)}
)
indices = sensitivity.global_indices(ranged.batch, ranged.names, box, "sobol", 128, 0)
tornado.global_picture(indices, "angle.4.std", "sobol.png")
print(f"{indices.runs} runs, mean {indices.mean:.3f} rad, standard deviation {indices.std:.3f} rad")
Image("sobol.png", width=640)

# %% [markdown]
# Linear damping explains most of the scatter. Quadratic damping acts partly only in combination with it (the light bar
# is longer than the dark one). A mass known to 10 % hardly matters. The thin lines are the errors of the indices at
# this number of runs: they decrease with its square root.
