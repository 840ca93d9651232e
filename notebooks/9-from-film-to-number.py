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
# # 9. From a film to a number
#
# A chain swings in front of a camera. How strongly is it damped? This notebook shows all steps: film, angle traces,
# fit, errors of the rig found by the fit, damping law, and one run over the whole trace with its prediction
# horizon. The film is rendered from a simulated run, so that the truth is known. With a film of your own, start at the
# second step.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dropper_jax as dj
from dropper_jax.plots import style
from fitting import View, advise, compare, film, fit, fit_and_free, fitted_scene, predict, simulate_truth, write_video
from fitting.films import track

LINKS, DURATION = 3, 12.0
plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## The film
#
# The links are 12 cm long with a marker on every node, and have linear and quadratic drag. The chain is released from a
# nearly horizontal position. The camera has a bending lens, noise, and an exposure of 1/640 s.

# %%
TRUTH = {"b_l": 0.003, "b_q": 0.004}
RIG = {
    "run": {"dt": 0.005, "duration": DURATION},
    "point": [
        {"name": "hook", "position": [0.0, 0.0, 0.0]},
        {"name": "tip", "kind": "free", "position": [0.12 * LINKS, 0.0, 0.0]},
    ],
    "line": [{"name": "chain", "from": "hook", "to": "tip", "links": LINKS, "length": [0.12] * LINKS, "mass": 0.05}],
    "effects": {
        "weight": {},
        "linear_damping": {"b_l": TRUTH["b_l"]},
        "quadratic_damping": {"b_q": TRUTH["b_q"]},
    },
    "start": {"kind": "angles", "zero": "down", "polar": [1.2, 1.3, 1.4][:LINKS]},
}
true_scene = dj.load_scene(RIG)
motion = simulate_truth(true_scene, DURATION, rate=480.0, substeps=5)
view = View(bending=(-0.12, 0.05), centre=(0.0, -0.15), distance=1.0, noise=5.0)
frames = list(film(motion, view, fps=60.0))
write_video("swing.avi", iter(frames), 60.0)
fig, axes = plt.subplots(1, 4, figsize=(10, 2.2), layout="constrained")
for ax, i in zip(axes, np.linspace(0, 60, 4).astype(int), strict=True):
    ax.imshow(frames[i], cmap="gray", vmin=0, vmax=255)
    ax.set_title(f"{i / 60:.2f} s")
    ax.axis("off")
plt.show()

# %% [markdown]
# ## Angles
#
# `track` finds the circles, their assignment to nodes, and the angles with their standard errors. Its only input is the
# number of markers, without a board or a scale. Angles need no scale, and the lengths of rigid links reveal the lens.

# %%
tracked = track("swing.avi", LINKS + 1)
link = np.diff(motion.nodes[::8, :, [0, 2]], axis=1)
true_angle = np.arctan2(link[..., 1], link[..., 0])
off = tracked.trace.theta - true_angle[np.round(tracked.trace.t * 60).astype(int)]
off -= 2 * np.pi * np.round(off / (2 * np.pi))
print(f"{tracked.status}: {len(tracked.trace.t)} frames, {tracked.trace.links} links")
rms, stated = np.sqrt(np.nanmean(off**2)), np.nanmean(tracked.trace.se)
print(f"error of the angles: {1e3 * rms:.2f} mrad RMS, stated {1e3 * stated:.2f}")

# %% [markdown]
# ## A first fit and its warnings
#
# The assumed scene has a mistake: the second link was measured 1.5 mm too long. The fit ends with a biased damping, but
# it warns: chi-square shows that the residuals are not noise. The advice lists possible explanations, each with its
# gain.

# %%
believed = true_scene.with_values(
    {
        "line.0.length": [0.12, 0.1215, 0.12][:LINKS],
        "effects.linear_damping.b_l": 0.01,
        "effects.quadratic_damping.b_q": 0.001,
    }
)
first = fit(tracked.trace, believed, ["b_l", "b_q"])


def show(result):
    """Truth and estimate of both coefficients."""
    for name, value, error in zip(TRUTH, result.values, result.uncertainty.std_error, strict=False):
        departure = (value - TRUTH[name]) / error
        print(f"{name}: {value:.6f} +- {error:.6f}, truth {TRUTH[name]:g}, off by {departure:+.1f} standard errors")
    print(f"chi-square per degree of freedom {result.chi2_per_dof:.3g}\n")


show(first)
for line in first.warnings + [str(candidate) for candidate in advise(first) if candidate.worth_naming]:
    print("-", line)

# %% [markdown]
# ## The fit that frees wrong parameters
#
# `fit_and_free` tries the candidates of the advice one at a time, with a fit of each, and keeps the one with the
# largest gain. Here it selects the lengths, which the score tests rank first. It ends when no candidate improves
# the fit.

# %%
result = fit_and_free(tracked.trace, believed, ["b_l", "b_q"])
show(result)
print("freed:", ", ".join(candidate.name for candidate in result.freed) or "nothing")
for parameter, value, error in zip(result.parameters, result.values, result.uncertainty.std_error, strict=True):
    if parameter.name.startswith("line"):
        print(f"{parameter.name}: {1e3 * value:.3f} +- {1e3 * error:.3f} mm")

# %% [markdown]
# ## The law
#
# Does the trace require both parts of the drag? Every subset of linear and quadratic drag and of viscous and dry
# friction in the joints is fitted to the same windows, and scored on blocks that it has not used.

# %%
fixed = fitted_scene(result.scene, result.model, result.parameters, result.values)
laws = compare(fit(tracked.trace, fixed, ["b_l", "b_q"], method="windows"))
best = max(law.score for law in laws)
for law in sorted(laws, key=lambda law: -law.score)[:6]:
    print(f"{law.name:40s} log score {law.score - best:10.1f} {'<- chosen' if law.chosen else ''}")

# %% [markdown]
# ## One run over the whole trace
#
# Windows are used for fitting; the purpose of a simulator is one run from one start. A second run that starts one
# standard error away shows how long the prediction is valid.

# %%
for each in (first, result):
    print(predict(each).text)
whole, naive = predict(result), predict(first)
fig, axes = plt.subplots(2, 1, figsize=(9, 4.2), sharex=True, layout="constrained")
axes[0].plot(whole.t, whole.measured[:, -1], ".", ms=2, color=style.DARK, label="film")
axes[0].plot(whole.t, whole.simulated[:, -1], lw=1, color=style.FIRST, label="one run")
axes[0].set_ylabel(f"link {LINKS} [rad]")
axes[0].legend(loc="upper right", ncols=2, markerscale=3)
for each, colour, label in ((naive, style.SECOND, "first fit"), (whole, style.FIRST, "lengths freed")):
    apart = 1e3 * np.sqrt(np.nanmean((each.simulated - each.measured) ** 2, axis=1))
    axes[1].semilogy(each.t, apart, lw=1, color=colour, label=label)
axes[1].set(xlabel="time [s]", ylabel="off the film [mrad RMS]")
axes[1].legend(loc="upper left", ncols=2)
plt.show()

# %% [markdown]
# ## A scene for further use
#
# The results go back into a scene, which every command accepts. `dropper fit swing.csv --scene chain.toml
# --auto-free --report report` does all of this from the command line, and writes `report/fitted.toml`.

# %%
from dropper_jax import as_toml  # noqa: E402

calibrated = fitted_scene(result.scene, result.model, result.parameters, result.values)
Path("fitted.toml").write_text(as_toml(calibrated.as_written()))
run = dj.simulate("fitted.toml", duration=2.0)
print(run.status, f"maximum tension {run.tension.max():.2f} N")
print(
    "\n".join(
        line for line in Path("fitted.toml").read_text().splitlines() if "length" in line or line.startswith("b_")
    )
)
