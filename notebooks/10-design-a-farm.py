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
# # 10. A farm, from a site to a design
#
# A site is a scene with further engineering data: sea states, currents, and the capacity of each part. Here the
# packaged `small-longline` (four loops in 25 m of water) passes through all steps. They are load cases with a leg that
# breaks, the weak part, a design with less material that meets all limits, the check of the broken leg, and the
# season's floats. At the end, three rows of four longlines reduce the current for each other.

# %%
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image, display

import dropper_jax as dj
from dropper_jax.cli.printing import table
from dropper_jax.plots import style
from fitting.cli.optimise import text
from fitting.farm.cases import assess, run_cases
from fitting.farm.optimise.picture import draw_design
from fitting.farm.optimise.run import optimise
from fitting.farm.optimise.variables import read_variables
from fitting.farm.season import plan_season, write_season
from fitting.farm.site import read_site

plt.rcParams.update(style.RC | {"figure.dpi": 90})

# %% [markdown]
# ## Load cases
#
# A gale of one minute, with all lines intact and with the western leg, which the current loads, broken after half a
# minute. The factors are examples: use your standard's.

# %%
plain = dict(read_site("small-longline").table)
plain["run"] = {"duration": 60.0, "seeds": 1, "skip": 15.0}
plain["cases"] = {"currents": [0.9], "states": ["intact", "west-leg"], "break_time": 30.0}
plain["factors"] = {"intact": 3.0, "broken": 1.67, "source": "example"}
plain["name"] = "small-longline"
site = read_site(plain)


def used(site, folder):
    """Utilisation of each part in each case."""
    run_cases(site, folder)
    found = assess(site, folder)
    names = [case["name"] for case in found["cases"]]
    rows = [("part", *names)]
    rows += [(part["part"], *(f"{case['utilisation']:.2f}" for case in part["cases"])) for part in found["parts"]]
    return found, table(rows)


before, words = used(site, "before")
print(words)

# %% [markdown]
# The legs are the weak part; the other parts have reserves. A design can reduce these reserves.
#
# ## A design by its gradients
#
# The problem has four variables, minimum material as the objective, and all limits as constraints: of the storm, of the
# storm with the broken leg, and of the backbone's depth. Derivatives are differences of runs around the largest
# load of every storm, all in the same steps, and include the equilibrium. The search first checks them by a larger
# change along the gradient; the window with the broken leg, whose loads are far from their limits here, changes by half
# of what they predict, and the search says so. A design is accepted if its whole runs meet every limit.

# %%
plain["optimise"] = {"window": 45.0, "before": 30.0, "rounds": 6}
site = read_site(plain)
found = optimise(site)
print(text(found))
display(Image(str(draw_design(site, found, "design.png"))))

# %% [markdown]
# ## The leg breaks, and the rest holds
#
# The design is checked by the load cases again, with the command for load cases, which does not use windows or
# gradients. In the picture above the current comes from the west. Nothing in this site demands a level backbone, so
# the floats shrink to their lower bound, and its western end sinks to 3.8 m; `deepest` allows 6 m.

# %%
variables = read_variables(plain["variable"], site.scene)
design = {v.path.removeprefix("parameters."): float(x) for v, x in zip(variables, found.after, strict=True)}
better = read_site({**plain, "parameters": {**plain["parameters"], **design}})
after, words = used(better, "after")
print({name: round(value, 4) for name, value in design.items()})
print(words)

# %% [markdown]
# ## The season
#
# Mussels grow on the droppers of a small farm. Floats must carry them in every month: too few let the farm sink, and
# too many lift it out of the water. The schedule is the one with the fewest visits.

# %%
bay = dict(read_site("exposed-bay").table)
bay["name"] = "bay"
bay["parameters"] = {**bay["parameters"], "droppers": 2}
bay["season"] = {**bay["season"], "levels": [0.0], "currents": [0.0, 0.5]}
months = plan_season(read_site(bay))
rows = [("month", "floats", "allowed", "to carry [kN]", "backbone [m]")]
rows += [
    (
        month["month"],
        str(month["floats"]),
        f"{month['least']} to {month['most']}",
        f"{month['need_n'] / 1e3:.2f}",
        f"{month['shallowest_m']:.1f} to {month['deepest_m']:.1f}",
    )
    for month in months["months"]
]
print(table(rows))
print(f"{months['visits']} visits, {months['handled']} floats handled")
write_season(months, "season")
display(Image("season/season.png"))

# %% [markdown]
# ## Three rows of four longlines
#
# `longline-rows` is defined by parameters, a unit and an array; anchors are shared along the rows. The current comes
# across the rows, and each row is in the wakes of those upstream: the water is slower where momentum was extracted, and
# the downstream legs carry less load.

# %%
farm = dj.load_scene("longline-rows")
plain = farm.as_written()
plain["effects"]["morison_drag"] = {}
alone = dj.load_scene(plain)
row, legs = range(1, int(farm.value("parameters.rows")) + 1), {}
for label, scene in (("no wakes", alone), ("wakes", farm)):
    pose = dj.equilibrium(scene)
    edges = np.cumsum([0, *(line.links for line in scene.lines)])
    peak = {line.name: pose.tension[a:b].max() for line, a, b in zip(scene.lines, edges, edges[1:], strict=False)}
    legs[label] = [max(v for k, v in peak.items() if k.startswith(f"r{r}") and k.endswith("leg")) for r in row]
    print(f"{label}: maximum leg tension by row {np.round(np.array(legs[label]) / 1e3, 2)} kN ({pose.status})")
fig, ax = plt.subplots(figsize=(7.5, 2.8), layout="constrained")
bars = ax.bar(row, 100 * (1 - np.array(legs["wakes"]) / np.array(legs["no wakes"])), 0.5, color=style.FIRST)
ax.bar_label(bars, fmt="%.1f %%")
ax.margins(y=0.15)
ax.set(xlabel="row, in the direction of the current", ylabel="reduction by wakes [%]", xticks=list(row))
ax.set_title("maximum leg tension", loc="left")
plt.show()
