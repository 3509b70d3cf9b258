# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Five people in the best corridor
#
# Three corridors lead to the goal. A is the shortest and C the longest, so the prior weights are
# $w_A > w_B > w_C$. Then five people come out of A. A planner of two layers keeps the corridor
# that the map prefers, and lets its lower layer struggle. Here both are one density, and the most
# probable plan under it may lie in another corridor.
#
# Run this file as a script from the repository, or make it a notebook with
# `jupytext --to notebook notebooks/five_people.py`.

# %%
from pathlib import Path

import gtsam
import matplotlib.pyplot as plt
import numpy as np

from fgplan import GivenPlan, Scenario, keys, plan, selection
from fgplan.drawing import describe, models
from fgplan.plotting import draw_plans

folders = (folder / "data" / "scenarios" for folder in (Path.cwd(), *Path.cwd().parents))
scenarios = next(folder for folder in folders if folder.is_dir())
empty = Scenario.load(scenarios / "three_corridors.toml")
crowded = Scenario.load(scenarios / "three_corridors_crowd.toml")
len(empty.tracks), len(crowded.tracks)

# %% [markdown]
# ## The density
#
# One model per hypothesis. A model is a list of terms, each a factor of `docs/density.md` at a
# range of time steps. The people are one variable a step, next to the robot's.

# %%
model = next(iter(models(crowded).values()))
print(describe(model))

# %% [markdown]
# The same terms make a plain GTSAM graph, whose error is $-\log$ of the density. At the
# hypothesis's own plan, people as predicted, it is far from its minimum:

# %%
graph, start = model.graph(), model.values(model.reference)
print(f"{graph.size()} factors, {start.size()} variables, energy {graph.error(start):.1f} nats")

# %% [markdown]
# ## Solving it
#
# `plan` solves every hypothesis from several starts, checks each optimum, and weighs them.

# %%
alone, among = plan(empty), plan(crowded)
print(f"alone {alone.best.label}, among people {among.best.label}")
draw_plans([(alone, empty), (among, crowded)])

# %% [markdown]
# ## Height and mass
#
# *Height* is the probability of the single best joint trajectory of a hypothesis,
# $\log w_i - E_i$. *Mass* integrates over all trajectories, $\log w_i + \log Z_i$: a hypothesis
# with room around its optimum gains. Both are always reported; `select` says which one decides.

# %%
for component, height, mass in zip(
    among.components, among.probability_height, among.probability_mass, strict=True
):
    moved = ", ".join(f"{name} {far:.1f}" for name, far in component.displacement.items())
    print(f"{component.label}  height {height:.3f}  mass {mass:.3f}  moves {moved}")

by_mass = plan(crowded, select=selection.mass)
print("by mass:", by_mass.best.label)

# %% [markdown]
# The numbers behind each name say how far that person is asked to move from their own
# prediction, in standard deviations: the joint optimum moves people too.
#
# ## Where the choice flips
#
# Give the two best corridors as plans of our own, and sweep the ratio of their weights. Nothing
# else depends on the weights, so the choice must flip where
# $\log(w_1/w_2) = E_1 - E_2$.

# %%
routes = {c.label: c.route for c in among.components}
first, second = alone.best.label, among.best.label
ratios = np.geomspace(0.2, 30.0, 9)
flips, chosen = {}, {}
for scene in (empty, crowded):
    pairs = [
        (GivenPlan(first, routes[first], ratio), GivenPlan(second, routes[second], 1.0))
        for ratio in ratios
    ]
    mixtures = [plan(scene.replace(plans=pair, count=0)) for pair in pairs]
    energy = {c.label: c.energy for c in mixtures[0].components}
    flips[scene.name] = float(np.exp(energy[first] - energy[second]))
    chosen[scene.name] = [
        dict(zip([c.label for c in m.components], m.probability_height, strict=True))[first]
        for m in mixtures
    ]
    print(f"{scene.name}: {first} is chosen above w1/w2 = {flips[scene.name]:.3f}")

# %%
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, probability in chosen.items():
    (line,) = axes.semilogx(ratios, probability, "o-", label=name)
    axes.axvline(flips[name], color=line.get_color(), ls=":")
axes.axhline(0.5, color="grey", lw=0.8)
axes.set(xlabel=f"prior weights, w({first}) / w({second})", ylabel=f"P({first}) by height")
axes.legend()
figure

# %% [markdown]
# The people move the flip: where the map alone would have needed a ratio below one to leave the
# short corridor, it now takes a strong preference to stay in it.
#
# ## A factor of your own
#
# Any GTSAM factor on the variables of `fgplan.keys` joins the graph. This one asks the robot to
# be slow, 0.5 m/s forward, two seconds from now.

# %%
step = round(2.0 / crowded.density.dt)
slow = gtsam.PriorFactorVector(
    keys.robot(step),
    np.array([0.0, 0.0, 0.5, 0.0]),
    gtsam.noiseModel.Diagonal.Sigmas([1e3, 1e3, 0.05, 1e3]),  # only vx says anything
)
asked = plan(crowded, factors=[slow])
for name, mixture in (("without", among), ("with", asked)):
    vx = mixture.trajectory.velocities[step, 0]
    print(f"{name} the factor: {mixture.best.label}, vx = {vx:.2f} m/s at {step} steps")
