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
# # Any inference on one density
#
# Once planning is a density, how it is inferred is a choice of its own. Here one hypothesis, a way
# straight on with somebody standing in it, is inferred by optimisation, by Laplace's method and by
# three samplers; then the dynamic window of the ROS navigation stack comes out as one more sampler.
# The density is the paper's, without the hinge on contact.
#
# Run this file as a script from the repository, or make it a notebook with
# `jupytext --to notebook notebooks/any_inference.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np

from fgplan import Density, GivenPlan, Level, OccupancyGrid, Robot, Scenario, Track, plan
from fgplan.inference import HMC, MAP, EllipticalSlice, Importance, Laplace
from fgplan.peers.costmap import Costmap, Inflation, shortest_path
from fgplan.peers.dwa import Scene, Weights, Window, choose
from fgplan.peers.special_case import UniformWindow, infer, potentials

times = np.array([-0.8, -0.4, 0.0])
anna = Track("anna", times, np.tile([1.6, 0.0], (3, 1)))
scenario = Scenario(
    Robot(np.zeros(2), np.array([0.8, 0.0])),
    plans=(GivenPlan("straight on", np.array([[0.0, 0.0], [9.0, 0.0]])),),
    count=0,
    tracks=(anna,),
    crowd="predicted",
    density=Density(horizon=2.0, h_c=0.6, contact_sigma=np.inf),
    levels=(Level(h=0.3),),
)

# %% [markdown]
# ## Five methods
#
# `plan` takes a method by name, `inference="hmc"`, or with settings. All return the same kind of
# result: weighted trajectories, the log evidence with its error, what they are worth, and why they
# might not be trusted.

# %%
methods = [
    MAP(),
    Laplace(),
    Importance(),
    EllipticalSlice(draws=300, warmup=200),
    HMC(draws=100, warmup=100),
]
found = {}
for method in methods:
    (component,) = plan(scenario, inference=method, seed=1).components
    result = found[method.name] = component.inferred
    error = result.log_evidence_error
    said = "no evidence" if result.log_evidence is None else f"log Z = {result.log_evidence:.2f}"
    said += "" if error is None else f" ± {error:.2f}"
    ess = result.diagnostics.ess
    said += "" if ess is None else f", {ess:.0f} effective"
    print(f"{method.name:11} {said}; {'; '.join(result.warnings) or 'no doubts'}")

# %% [markdown]
# MAP is a point and says how many others there are. Laplace takes the surroundings of each optimum for
# a Gaussian, cut off by the robot's limits. Chains need no Gaussian, and more time: these are short,
# and say so.
#
# ## A mean over modes is a collision
#
# There are two ways round anna, and the mean of both leads into her. So expectations are for
# evidence, and what is driven is an optimum or the most probable sample.

# %%
result = found["importance"]
drawn = result.resampled(60, seed=0)
robot = result.model.columns["robot"].start
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for state in drawn:
    axes.plot(state[:, robot], state[:, robot + 1], color="C0", alpha=0.2)
mean, best = result.mean[:, robot : robot + 2], result.best[:, robot : robot + 2]
axes.plot(*mean.T, "k--", label="mean of the samples")
axes.plot(*best.T, "C3", lw=2, label="most probable sample")
axes.add_patch(plt.Circle((1.6, 0.0), 0.3, color="C1"))
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()
gaps = [np.linalg.norm(path - [1.6, 0.0], axis=1).min() for path in (mean, best)]
left = result.weights[result.states[:, 4, robot + 1] > 0].sum()
print(f"weight on the left {left:.2f}; nearest to anna: mean {gaps[0]:.2f} m, best {gaps[1]:.2f} m")

# %% [markdown]
# ## Where sampling from the prior collapses
#
# The paper reads the ROS stack as importance sampling from what the robot can do. The tighter the
# coupling to the plan, the fewer samples are worth anything.

# %%
widths = (3.0, 0.3, 0.03, 0.003)
for source in ("kinematic", "laplace"):
    shares = []
    for h in widths:
        tight = scenario.replace(tracks=(), levels=(Level(h=h),))
        (component,) = plan(tight, inference=Importance(4000, source)).components
        shares.append(component.inferred.diagnostics.ess / 4000)
    line = ", ".join(f"h = {h:g}: {s:.4f}" for h, s in zip(widths, shares, strict=True))
    print(f"{source:9} effective share of the samples: {line}")

# %% [markdown]
# ## The dynamic window as a special case
#
# With one plan, ψ = exp(−cost) and a prior that is even over the dynamic window, the sample with
# the largest ψ·p is the command that the dynamic window approach takes (`docs/robots.md`).

# %%
box = [(1.5, -0.3), (2.1, -0.3), (2.1, 0.5), (1.5, 0.5)]
grid = OccupancyGrid.from_polygons([box], bounds=(-1, -2, 4, 2), resolution=0.05)
costmap = Costmap.build(grid, Inflation(0.25))
way = shortest_path(costmap, np.zeros(2), np.array([3.5, 0.0]))
window, velocity = Window(), np.array([0.6, 0.0])
commands = window.sample(velocity, 300, np.random.default_rng(0))
samples = window.roll_out(np.zeros(3), commands)
scene = Scene.build(costmap, way, Weights())
by_window = choose(scene, samples).index
by_density = infer(UniformWindow(window, velocity), potentials(scene), samples)
same = np.array_equal(by_density.best, samples[by_window])
print(f"the dynamic window takes v, ω = {commands[by_window].round(3)}; the density: same = {same}")

# %%
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(*way.T, "k:", label="global plan")
axes.plot(samples[..., 0].T, samples[..., 1].T, color="C0", alpha=0.05)
axes.plot(*by_density.best[:, :2].T, "C3", lw=2, label="largest ψ·p")
axes.add_patch(plt.Polygon(box, color="grey"))
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()
figure
