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
# # 4. Damping, from traces to coefficients
#
# How strongly is a dropper damped? The thesis filmed its laboratory model, tried values of two coefficients, and
# compared by eye. It could not settle: with one pair the beginning was right and the end wrong, with another the
# reverse. There are two reasons, and this notebook shows both: the error as a function of the coefficients is a
# needle in a haystack, because the dropper is chaotic; and the law itself may be wrong, because bearings rub.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dropper_jax as dj
from dropper_jax.plots import style
from fitting.fit import fit
from fitting.synthetic import Camera, observe, simulate_truth

FAST = bool(os.environ.get("DROPPER_NOTEBOOKS_FAST"))
plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## A known truth
#
# A trace whose damping we know: a simulated run, seen by a camera at 60 frames a second with an angle noise of 0.005
# rad (a video of real markers is better than that: `dropper track` gives 0.0005 rad on its test videos).

# %%
PAIR = {
    "run": {"dt": 0.01, "duration": 10.0},
    "point": [
        {"name": "pivot", "position": [0.0, 0.0, 0.0]},
        {"name": "end", "kind": "free", "position": [0.4, 0.0, 0.0]},
    ],
    "line": [{"name": "pair", "from": "pivot", "to": "end", "links": 2, "length": 0.2, "mass": 0.05}],
    "effects": {"weight": {}, "linear_damping": {"b_l": 0.004}, "quadratic_damping": {"b_q": 0.006}},
    "start": {"kind": "angles", "zero": "down", "polar": [1.9, 2.2]},
}
DURATION = 4.0 if FAST else 16.0
SCENE = PAIR if FAST else dj.load_scene("dropper-release-a")
scene = dj.load_scene(SCENE)
DAMPING = (("linear_damping", "b_l"), ("quadratic_damping", "b_q"))
truth = {f"effects.{effect}.{key}": scene.effects[effect][key] for effect, key in DAMPING}
trace = observe(simulate_truth(scene, DURATION, 60.0), Camera(rate=60.0, angle_noise=0.005), seed=0)
print(f"{trace.links} links, {len(trace.t)} frames, {trace.t[-1]:.0f} s")
print("truth: " + ", ".join(f"{path.split('.')[-1]} = {value:g}" for path, value in truth.items()))

# %% [markdown]
# ## The haystack
#
# The naive way: simulate the whole trace with other damping and look at the error. All starts are exactly right here,
# which no experiment offers, and still:

# %%
factors = np.array([0.5, 0.9, 1.0, 1.1, 2.0]) if FAST else np.geomspace(0.25, 4, 61)


def whole_error(factor):
    """RMS error [rad] of one long run whose b_l is off by a factor."""
    path = "effects.linear_damping.b_l"
    changed = scene.with_values({path: truth[path] * float(factor)})
    run = dj.simulate(changed, duration=DURATION, dt=1 / 240, save_every=4, integrator="rattle")
    count = min(len(run.t), len(trace.t))
    difference = np.exp(1j * run.polar[:count]) / np.exp(1j * trace.theta[:count])
    return float(np.sqrt(np.mean(np.angle(difference) ** 2)))


errors = [whole_error(factor) for factor in factors]
fig, ax = plt.subplots(figsize=(8, 3.2))
ax.semilogx(factors, errors, "o-", color=style.FIRST, ms=4)
ax.axvline(1.0, color=style.SECOND, ls="--", lw=1)
ax.annotate("truth", (1.0, max(errors)), (6, -4), textcoords="offset points", color=style.SECOND)
ax.set(xlabel="b_l, as a multiple of the truth", ylabel="RMS error of the trace [rad]", ylim=(0, None))
plt.show()

# %% [markdown]
# Far from the truth the error is the same everywhere: once two motions have parted, they are as different as any two.
# No search finds its way down here, and neither does an eye.
#
# ## Windows
#
# What works: cut the trace into windows so short that chaos has no time, give each its own start, and let only the
# coefficients be common. All of it is solved at once, with exact derivatives, from coefficients that are wrong by a
# factor:

# %%
wrong = scene.with_values({key: 3 * value for key, value in truth.items()})
result = fit(trace, wrong, ["b_l", "b_q"], method="windows" if FAST else "shooting")
print(f"{result.status}: {result.windows.count} windows of {result.windows.length:.2f} s")
print(f"small errors grow as exp({result.lyapunov:.1f} t)\n")
print(f"{'':6s}{'truth':>10s}{'started at':>12s}{'found':>10s}{'std error':>12s}{'off by':>9s}")
for i, (path, true) in enumerate(truth.items()):
    value, error = result.values[i], result.uncertainty.std_error[i]
    off = 100 * (value / true - 1)
    print(f"{path[-3:]:6s}{true:10.5f}{3 * true:12.5f}{value:10.5f}{error:12.5f}{off:8.1f}%")
print(f"\nresidual {result.rms:.4f} rad, noise 0.0050 rad; chi-square per degree of freedom {result.chi2_per_dof:.2f}")

# %%
from fitting.pictures import fitted  # noqa: E402

t, measured, model, _ = fitted(result, 0)
shown = t < t[0] + 3.0
fig, axes = plt.subplots(2, 1, figsize=(9, 4.2), sharex=True, layout="constrained")
for ax, link in zip(axes, (0, min(2, trace.links - 1)), strict=True):
    ax.plot(t[shown], measured[shown, link], ".", color=style.FAINT, ms=4, label="camera")
    ax.plot(t[shown], model[shown, link], color=style.FIRST, lw=1, label="fit")
    ax.set_ylabel(f"link {link + 1} [rad]")
axes[0].legend(loc="upper right", ncols=2)
axes[1].set_xlabel("time [s]")
plt.show()

# %% [markdown]
# ## Real pendulums
#
# Kaheman and others filmed nothing but read encoders: a single and a double pendulum on ball bearings, free to swing,
# at a thousand samples a second (arXiv 2205.06231, data public under the MIT licence). They published the parameters
# that they fitted. The judge is a stretch of the trace that no fit has seen. Where the data is not there, this part
# shows nothing.

# %%
folder = os.environ.get("DROPPER_MEASURED_DATA", "")
data = Path(folder) / "single_pendulum.csv" if folder else None
rows = []
if data is not None and data.exists() and not FAST:
    rig = dj.load_scene("measured-single-pendulum")
    judged = [(36.668, 45.834), (45.834, 55.0)]
    laws = {"viscous": ["viscous"], "viscous and dry": ["viscous", "dry"]}
    for label, free in laws.items():
        found = fit(
            data, rig, ["line.0.inertia", "camera.offset", *free],
            method="windows", until=36.668, held_out=judged, window=9.16, zero="down", sign=1, unit="rad",
        )  # fmt: skip
        rows.append((label, [h.rms for h in found.held_out]))
        named = zip(found.parameters, found.values, strict=True)
        print(f"{label:18s}", ", ".join(f"{p.name.split('.')[-1]} = {value:.3g}" for p, value in named))
else:
    print("measured traces are not here: set DROPPER_MEASURED_DATA to the folder of the public data set")

# %%
if rows:
    rows.insert(0, ("published (viscous)", [0.0067, 0.0129]))
    fig, ax = plt.subplots(figsize=(7.5, 3.0), layout="constrained")
    for i, (label, values) in enumerate(rows):
        ax.barh(
            np.arange(2) + 0.25 * (1 - i),
            1e3 * np.array(values),
            0.22,
            label=label,
            color=(style.FAINT, style.FIRST, style.SECOND)[i],
        )
    ax.set(
        yticks=[0, 1],
        yticklabels=["37 to 46 s", "46 to 55 s"],
        xlabel="error on what no fit has seen [mrad]",
        title="single pendulum",
    )
    ax.invert_yaxis()
    ax.legend()
    ax.grid(axis="y", visible=False)
    plt.show()

# %% [markdown]
# The bearing is dry. A viscous law alone cannot bring a pendulum to rest, and whatever coefficient it is given is a
# compromise between the fast beginning and the slow end: the thesis' dilemma. `dropper fit --compare-models` makes
# this comparison for a whole ladder of laws.
