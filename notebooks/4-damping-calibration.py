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
# compared by eye. The result was ambiguous: one pair fitted the beginning but not the end, and another the reverse.
# This notebook shows the two reasons. First, the error as a function of the coefficients has an extremely narrow
# minimum, because the dropper is chaotic. Second, the law itself may be wrong, because bearings have friction.

# %%
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import dropper_jax as dj
from dropper_jax.plots import style
from fitting import Camera, GradientDescent, close_chain, fit, loss_of_trace, observe, simulate_truth, to_state, wrap

plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## A known truth
#
# A trace with known damping: a simulated run, seen by a camera at 60 frames per second with an angle noise of 0.005 rad
# (a video of real markers is better: `dropper track` reaches 0.0005 rad on its test videos).

# %%
DURATION = 16.0
scene = dj.load_scene("dropper-release-a")
DAMPING = (("linear_damping", "b_l"), ("quadratic_damping", "b_q"))
truth = {f"effects.{effect}.{key}": scene.effects[effect][key] for effect, key in DAMPING}
trace = observe(simulate_truth(scene, DURATION, 60.0), Camera(rate=60.0, angle_noise=0.005), seed=0)
print(f"{trace.links} links, {len(trace.t)} frames, {trace.t[-1]:.0f} s")
print("truth: " + ", ".join(f"{path.split('.')[-1]} = {value:g}" for path, value in truth.items()))

# %% [markdown]
# ## The method as one short program
#
# The program uses public functions: a jitted residual of a time step, its Jacobian by `jax.jacfwd`, Newton's method in
# a `lax.scan` (as in the solver `dense`), windows of the trace, and optax for the two coefficients. It starts from
# values wrong by a factor of ten. The start of every window is fitted too, by one Gauss-Newton step per step of the
# descent. The rest of this notebook shows why windows are necessary, and what `fit` adds.

# %%
model, _ = dj.build(scene)
STEPS, FRAMES = 4, 30  # time steps per frame, frames per window: 1/240 s and 0.5 s
h, ends = (trace.t[1] - trace.t[0]) / STEPS, model.ends(0.0)
first = np.arange(0, len(trace.t) - FRAMES, FRAMES)  # frame at which each window starts
measured = jnp.stack([trace.theta[k + 1 : k + 1 + FRAMES] for k in first])  # (windows, frames, links)
starts = jnp.stack([trace.theta, np.gradient(trace.theta, trace.t, axis=0)], axis=1)[first]  # angles and rates


@jax.jit
def residual(u, model, r0, v0):  # zero at the end u of a step: positions (nodes, 3) and tensions (links,)
    r1, tension = u[: r0.size].reshape(r0.shape), u[r0.size :]
    v, d0, d1 = (r1 - r0) / h, model.links(r0, ends), model.links(r1, ends)
    size0, size1 = jnp.linalg.norm(d0, axis=1), jnp.linalg.norm(d1, axis=1)
    along = (tension / (size0 + size1))[:, None] * (d0 + d1)  # force of each link
    force = model.force(model.kinematics((r0 + r1) / 2, v, 0.0)) + jnp.diff(along, axis=0, append=0.0)[: len(r0)]
    balance = 2 * model.line.mass[: len(r0), None] * (v - v0) / h - force
    return jnp.concatenate([balance.ravel(), size1 / model.line.length - 1])


def step(model, r0, v0, tension):  # Newton's method, with the Jacobian of the residual by jacfwd
    rows = partial(residual, model=model, r0=r0, v0=v0)

    def newton(u, _):
        return u - jnp.linalg.solve(jax.jacfwd(rows)(u), rows(u)), None

    u, _ = jax.lax.scan(newton, jnp.concatenate([(r0 + h * v0).ravel(), tension]), length=4)
    r1 = u[: r0.size].reshape(r0.shape)
    return r1, 2 * (r1 - r0) / h - v0, u[r0.size :]


def angle_errors(b, start, measured):  # of a window's angles (frames * links,) with damping b = (b_l, b_q)
    weight, linear, quadratic = model.effects
    damped = replace(model, effects=(weight, replace(linear, b_l=b[0]), replace(quadratic, b_q=b[1])))
    begin = to_state(damped, *close_chain(damped, *start))  # the links end at the second hook

    def frame(state, _):
        state, _ = jax.lax.scan(lambda state, _: (step(damped, *state), None), state, length=STEPS)
        d = damped.links(state[0], ends)
        return state, jnp.arctan2(-d[:, 2], d[:, 0])

    angles = jax.lax.scan(frame, (begin.r, begin.v, jnp.zeros(model.line.links)), length=FRAMES)[1]
    return wrap(angles - measured).ravel()


@jax.jit
def evaluate(b, starts):  # all windows: products of [slopes by b, errors], a square; better starts
    def window(start, measured):
        by_b, by_start = jax.jacfwd(angle_errors, (0, 1))(b, start, measured)
        columns = jnp.column_stack([by_b, angle_errors(b, start, measured)])
        by_start = by_start.reshape(len(columns), -1)
        best = jnp.linalg.lstsq(by_start, columns, rcond=1e-9)[0]
        left = columns - by_start @ best  # what no start explains
        return left.T @ left, start - best[:, 2].reshape(start.shape)

    products, starts = jax.vmap(window)(starts, measured)
    return products.sum(axis=0), starts


b, optimizer = jnp.array([0.02, 0.01]), optax.sgd(0.5)
for _ in range(4):  # the starts first
    products, starts = evaluate(b, starts)
unit = jnp.linalg.inv(jnp.linalg.cholesky(products[:2, :2])).T  # b = unit x; the loss curves by 1
x = jnp.linalg.solve(unit, b)
state = optimizer.init(x)
for _ in range(25):
    products, starts = evaluate(unit @ x, starts)
    change, state = optimizer.update(unit.T @ products[:2, 2], state)
    x = optax.apply_updates(x, change)
b, rms = unit @ x, jnp.sqrt(products[2, 2] / measured.size)
print("b_l, b_q =", b, "+-", rms * jnp.sqrt(jnp.diag(jnp.linalg.inv(products[:2, :2]))), "RMS error", rms, "rad")

# %% [markdown]
# ## The narrow minimum
#
# The naive method simulates the whole trace with other damping and computes the error. Here the start is exactly right,
# which no experiment offers. The result:

# %%
factors = np.geomspace(0.25, 4, 61)


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
ax.set_xticks([0.25, 0.5, 1, 2, 4], ["0.25", "0.5", "1", "2", "4"], minor=False)
ax.minorticks_off()
ax.axvline(1.0, color=style.SECOND, ls="--", lw=1)
ax.annotate("truth", (1.0, max(errors)), (6, -4), textcoords="offset points", color=style.SECOND)
ax.set(xlabel="b_l, as a multiple of the truth", ylabel="RMS error of the trace [rad]", ylim=(0, None))
plt.show()

# %% [markdown]
# No descent path leads to the true value. Once two motions have diverged they are as different as any two. After a
# quarter of a minute even the right coefficient does not stand out: the camera's dropper was computed with a finer step
# than these runs, and chaos has amplified that difference. Neither a search nor a visual comparison succeeds here.
#
# ## Windows
#
# The solution is to cut the trace into windows that are too short for chaos, and to give each its own start; only the
# coefficients are common. All unknowns are solved together, with exact derivatives, from coefficients that are wrong by
# a factor:

# %%
wrong = scene.with_values({key: 3 * value for key, value in truth.items()})
result = fit(trace, wrong, ["b_l", "b_q"], method="shooting")
print(f"{result.status}: {result.windows.count} windows of {result.windows.length:.2f} s")
print(f"small errors grow as exp({result.lyapunov:.1f} t)\n")
print(f"{'':6s}{'truth':>10s}{'started at':>12s}{'found':>10s}{'std error':>12s}{'off by':>9s}")
for i, (path, true) in enumerate(truth.items()):
    value, error = result.values[i], result.uncertainty.std_error[i]
    off = 100 * (value / true - 1)
    print(f"{path[-3:]:6s}{true:10.5f}{3 * true:12.5f}{value:10.5f}{error:12.5f}{off:8.1f}%")
print(f"\nresidual {result.rms:.4f} rad, noise 0.0050 rad; chi-square per degree of freedom {result.chi2_per_dof:.2f}")

# %%
from fitting.report.pictures import fit_over_trace  # noqa: E402

t, measured, model = fit_over_trace(result, 0)
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
# ## The loss and its gradient
#
# `loss_of_trace` gives the loss of the windows as a JAX function of the two coefficients alone: half of chi-square,
# with the start of every window at its optimum. `jax.grad(loss)` is exact. Three descents start from values wrong by a
# factor of ten, on the first four seconds: Adam of optax, in units of the start values; L-BFGS of optax, in logarithms;
# and Gauss-Newton steps, which use the curvature as well.

# %%
far = scene.with_values({key: 10 * value for key, value in truth.items()})
loss = loss_of_trace(trace, far, ["b_l", "b_q"], until=4.0)
paths = {name: [loss.params] for name in ("Adam", "L-BFGS", "Gauss-Newton")}

adam = optax.adam(optax.cosine_decay_schedule(0.2, 30), b1=0.5, b2=0.9)
state = adam.init(loss.params)
for _ in range(30):
    change, state = adam.update(jax.grad(loss)(paths["Adam"][-1]) * loss.scale, state)
    paths["Adam"].append(paths["Adam"][-1] + change * loss.scale)

lbfgs = optax.lbfgs()


@jax.jit
def descend(x, state):  # a step with its line search
    logarithmic = lambda x: loss(jnp.exp(x))  # noqa: E731
    value, gradient = jax.value_and_grad(logarithmic)(x)
    change, state = lbfgs.update(gradient, state, x, value=value, grad=gradient, value_fn=logarithmic)
    return x + change, state


x = jnp.log(loss.params)
state = lbfgs.init(x)
for _ in range(15):
    x, state = descend(x, state)
    paths["L-BFGS"].append(jnp.exp(x))

for _ in range(5):
    _, gradient, information = loss.gauss_newton(paths["Gauss-Newton"][-1])
    paths["Gauss-Newton"].append(paths["Gauss-Newton"][-1] - jnp.linalg.solve(information, gradient))

error = jnp.sqrt(jnp.diag(jnp.linalg.inv(information)))
for name, path in paths.items():
    print(f"{name:13s}b_l {path[-1][0]:.5f}, b_q {path[-1][1]:.5f}, loss {loss(path[-1]):.2f}")
print(f"{'std error':13s}    {error[0]:.5f},     {error[1]:.5f}")

# %%
axes_of_map = [true * np.geomspace(0.2, 12, 13) for true in truth.values()]
heights = np.array([[float(loss(jnp.array([b_l, b_q]))) for b_l in axes_of_map[0]] for b_q in axes_of_map[1]])
fig, ax = plt.subplots(figsize=(6, 4.2), layout="constrained")
ax.contour(*axes_of_map, np.log10(heights / heights.min()), levels=12, colors=style.FAINT, linewidths=0.8)
for (name, path), colour in zip(paths.items(), style.CYCLE, strict=False):
    ax.loglog(*np.array(path).T, ".-", ms=4, lw=1, color=colour, label=name)
ax.plot(*truth.values(), "+", ms=12, color=style.DARK, label="truth")
ax.set(xlabel="b_l [kg/s]", ylabel="b_q [kg/m]")
ax.legend()
plt.show()

# %% [markdown]
# All three end in the same valley, where four seconds hardly distinguish the two coefficients.
#
# ## By gradient descent on the whole trace
#
# `fit` minimises the same loss. With `GradientDescent` it descends by optax too, in coordinates in which the
# information is the unit matrix, so that the valley is round. The loss is shown per measured angle, in units of the
# noise: a right model gives 1. First the windows are separate. Then they are joined by gaps of decreasing size, and
# each change moves the minimum slightly.

# %%
WAYS = {
    "Gauss-Newton": {},
    "L-BFGS": {"method": GradientDescent("lbfgs")},
    "Adam": {"method": GradientDescent("adam")},
}
found = {name: fit(trace, far, ["b_l", "b_q"], **settings) for name, settings in WAYS.items()}
fig, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
for (name, each), colour in zip(found.items(), style.CYCLE, strict=False):
    if each.descent:
        axes[0].semilogy([point["loss"] for point in each.descent], ".-", ms=3, lw=1, color=colour, label=name)
    for i, ax in enumerate(axes[1:]):
        ax.plot([point["values"][i] for point in each.descent], color=colour, lw=1)
axes[0].set(xlabel="step", ylabel="loss per angle [noise$^2$]")
axes[0].legend()
for i, (ax, (path, true)) in enumerate(zip(axes[1:], truth.items(), strict=True)):
    ax.axhline(found["Gauss-Newton"].values[i], color=style.CYCLE[0], lw=0.8, label="Gauss-Newton")
    ax.axhline(true, color=style.DARK, lw=0.8, ls="--", label="truth")
    ax.set(xlabel="step", ylabel=path.split(".")[-1], ylim=(0, 10.5 * true))
axes[1].legend()
plt.show()

print(f"{'':14s}{'evaluations':>12s}{'time':>8s}   " + "   ".join(f"{path[-3:]:>20s}" for path in truth))
for name, each in found.items():
    pairs = zip(each.values, each.uncertainty.std_error, strict=True)
    numbers = "   ".join(f"{value:.6f} +- {error:.6f}" for value, error in pairs)
    print(f"{name:14s}{each.iterations:12d}{each.seconds['run']:7.0f}s   {numbers}")

# %% [markdown]
# All methods arrive at the same coefficients, with the same errors. Gauss-Newton is the default of `fit`, because it
# uses the curvature. Descent uses that curvature only for its coordinates, and then needs nothing but gradients.

# %% [markdown]
# ## Real pendulums
#
# Kaheman and others did not film but read encoders: a single and a double pendulum on ball bearings, swinging freely,
# at a thousand samples per second (arXiv 2205.06231, data public under the MIT licence). They published their fitted
# parameters. The test is a stretch of the trace that no fit has used. The fits take minutes, so this part shows the
# stored results of `python benchmarks/measured_pendulums.py`; it needs the data, in the folder DROPPER_MEASURED_DATA.

# %%
results = Path(dj.__file__).parents[1] / "benchmarks" / "results"
kept = {name: results / f"measured_{name}_pendulum.json" for name in ("single", "double")}
kept = {name: json.loads(path.read_text()) for name, path in kept.items() if path.exists()}
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.2), layout="constrained")
for ax, (name, found) in zip(axes, kept.items(), strict=False):
    place = np.arange(len(found["held_out_s"]))
    ax.barh(place - 0.18, 1e3 * np.array(found["published_rad"]), 0.32, color=style.FAINT, label="published parameters")
    ax.barh(place + 0.18, 1e3 * np.array(found["held_out_rad"]), 0.32, color=style.FIRST, label="fitted here")
    spans = [f"{low:.0f} to {high:.0f} s" for low, high in found["held_out_s"]]
    ax.set(yticks=place, yticklabels=spans, xlabel="error on what no fit has seen [mrad]", title=f"{name} pendulum")
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    print(f"{name} pendulum (fit ended with status {found['fit']['status']}), friction found:")
    for path, value in found["fit"]["parameters"].items():
        if "effects" in path:
            bound = ", at its bound" if value["at_bound"] else ""
            print(f"  {path:38s} {value['value']:.3g} +- {value['std_error']:.1g} {value['unit']}{bound}")
axes[0].legend()
plt.show()

# %% [markdown]
# The bearings are dry. If both laws are allowed, the fit sets the viscous coefficient of the single pendulum to zero.
# It explains the slow end by a dry torque and the fast beginning by the drag of the arm. Both are necessary. With a
# viscous and a dry torque but no drag, on windows of nine seconds, the dry torque became zero and the prediction was no
# better than the published one (6.5 and 16 mrad). A law that lacks a part biases the others, which is the thesis'
# dilemma again. `dropper fit --compare-models` compares a whole ladder of laws on stretches that they have not used.
