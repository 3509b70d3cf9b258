"""A robot that does what its planner says, among people who walk straight on."""

from __future__ import annotations

import numpy as np

from fgplan import (
    Density,
    OccupancyGrid,
    Robot,
    Scenario,
)
from fgplan.driving import Detection, Observation, Outcome, Settings

PERIOD = 0.2
SETTINGS = Settings(period=PERIOD, deadline=None)
DENSITY = Density(dt=0.4, horizon=4.0)
BLOCK = [(3.0, -1.0), (4.0, -1.0), (4.0, 1.0), (3.0, 1.0)]
GRID = OccupancyGrid.from_polygons([BLOCK], (-1, -3, 9, 3), 0.1, border=True)


def scenario(**changes):
    fields = {"goal": np.array([6.0, 0.0]), "crowd": "predicted", "density": DENSITY, **changes}
    return Scenario(Robot(np.zeros(2)), **fields)


class World:
    """A robot that does what it is told, and people who walk straight on."""

    def __init__(self, planner, *people, position=(0.0, 0.0)):
        self.planner, self.people = planner, np.array(people, dtype=float).reshape(-1, 4)
        self.position, self.velocity = np.array(position, dtype=float), np.zeros(2)
        self.heading, self.yaw_rate, self.time = None, 0.0, 0.0
        self.decisions = []

    def observation(self, **changes):
        detections = tuple(Detection(p[:2].copy(), f"p{i}") for i, p in enumerate(self.people))
        fields = {
            "detections": detections,
            "heading": self.heading,
            "yaw_rate": self.yaw_rate,
            **changes,
        }
        return Observation(self.time, self.position.copy(), self.velocity.copy(), **fields)

    def step(self, **changes):
        decision = self.planner.step(self.observation(**changes))
        self.follow(decision)
        return decision

    def follow(self, decision):
        self.decisions.append(decision)
        new = decision.action.velocity
        if self.heading is None:
            self.position = self.position + PERIOD / 2 * (self.velocity + new)
        else:
            self.position = decision.action.position
            self.heading += PERIOD / 2 * (self.yaw_rate + decision.action.twist.angular_z)
            self.yaw_rate = decision.action.twist.angular_z
        self.velocity = new
        self.people[:, :2] += PERIOD * self.people[:, 2:]
        self.time += PERIOD

    def run(self, steps):
        for _ in range(steps):
            if self.step().outcome is Outcome.GOAL_REACHED:
                break
        return self

    def gap(self):
        if not len(self.people):
            return np.inf
        return np.linalg.norm(self.people[:, :2] - self.position, axis=1).min() - 0.55


def is_sound(decision, limit=1.2):
    action = decision.action
    numbers = [*action.position, *action.velocity, action.twist.linear_x, action.twist.angular_z]
    return np.all(np.isfinite(numbers)) and np.linalg.norm(action.velocity) <= limit + 1e-6
