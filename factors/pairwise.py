"""Potentials between pairs of bodies: all pairs of a time step, and all time steps, in one call.

A potential says what two bodies at a separation Δ = p_i − p_j are worth; a wiring says which
bodies are variables. `interaction.py` and `contact.py` hold the potentials.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from factors.residual import Array, Expansion, Residual


class PairPotential(ABC):
    """A function of the separation Δ, shape (..., P, 2) for P pairs, as a whitened scalar error."""

    @abstractmethod
    def linearize(self, delta: Array) -> tuple[Array, Array]:
        """Error (..., P) and its gradient in Δ (..., P, 2)."""

    @abstractmethod
    def energy(self, delta: Array) -> Array:
        """−log of the potential, shape (..., P)."""

    @abstractmethod
    def expand(self, delta: Array) -> Expansion:
        """Energy (..., P), gradient (..., P, 2) and Hessian (..., P, 2, 2) in Δ."""

    def gauss_newton(self, delta: Array) -> Expansion:
        """The same with the Gauss–Newton Hessian, which is positive semidefinite."""
        e, slope = self.linearize(delta)
        return Expansion(
            0.5 * e**2, e[..., None] * slope, slope[..., :, None] * slope[..., None, :]
        )

    def at(self, step: int) -> Self:
        """This potential with the parameters of one time step."""
        return self


@dataclass(frozen=True, eq=False)
class CrowdPairs(Residual):
    """A potential between the robot and n people, and between people, all of them variables.

    Variables: robot (positions first), crowd (n positions, then anything).

    Args:
        potential: What a pair is worth.
        n: Number of people, at least 1.
        pairs: "all", or only the "robot" with each person.
        robot_dim: Size of the robot's variable.
    """

    potential: PairPotential
    n: int
    pairs: Literal["all", "robot"] = "all"
    robot_dim: int = 4
    space: int = 2

    @cached_property
    def dims(self) -> tuple[int, ...]:
        return (self.robot_dim, 2 * self.space * self.n)

    @cached_property
    def index(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Bodies i < j of each pair; the robot is body 0."""
        return pair_index(self.n, self.pairs)

    @property
    def rows(self) -> int:
        return len(self.index[0])

    @cached_property
    def support(self) -> NDArray[np.intp]:
        people = self.robot_dim + np.arange(self.space * self.n)
        return np.concatenate([np.arange(self.space), people])

    @cached_property
    def _incidence(self) -> Array:
        """Shape (P, n + 1): +1 for i, −1 for j."""
        G = np.zeros((self.rows, self.n + 1))
        rows = np.arange(self.rows)
        G[rows, self.index[0]], G[rows, self.index[1]] = 1, -1
        return G

    def separations(self, robot: Array, crowd: Array) -> Array:
        """Δ of all pairs, shape (..., P, space)."""
        people = crowd[..., : self.space * self.n]
        people = people.reshape(*crowd.shape[:-1], self.n, self.space)
        bodies = np.concatenate([robot[..., None, : self.space], people], axis=-2)
        i, j = self.index
        return np.asarray(bodies[..., i, :] - bodies[..., j, :])

    def energy(self, *x: Array) -> Array:
        return np.asarray(self.potential.energy(self.separations(*x)).sum(-1))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self.potential.linearize(self.separations(*x))
        J = self._incidence[:, :, None] * slope[..., :, None, :]
        J_robot = np.zeros((*e.shape, self.dims[0]))
        J_crowd = np.zeros((*e.shape, self.dims[1]))
        J_robot[..., : self.space] = J[..., 0, :]
        J_crowd[..., : self.space * self.n] = J[..., 1:, :].reshape(*e.shape, -1)
        return e, (J_robot, J_crowd)

    def expand(self, *x: Array) -> Expansion:
        return self._gather(self.potential.expand(self.separations(*x)))

    def gauss_newton(self, *x: Array) -> Expansion:
        return self._gather(self.potential.gauss_newton(self.separations(*x)))

    def _gather(self, pair: Expansion) -> Expansion:
        """Expansions of pairs (..., P) as one of all bodies."""
        batch, d = pair.energy.shape[:-1], self.space
        gradient = (self._incidence.T @ pair.gradient).reshape(*batch, -1)
        # Bodies (a, b) of a pair get +H on the diagonal and −H beside it.
        H = np.zeros((*batch, self.n + 1, d, self.n + 1, d))
        own = np.abs(self._incidence).T @ pair.hessian.reshape(*batch, -1, d * d)
        i, j = self.index
        body = np.arange(self.n + 1)
        for r in range(d):
            for c in range(d):
                H[..., body, r, body, c] = own[..., d * r + c]
                H[..., i, r, j, c] = -pair.hessian[..., r, c]
                H[..., j, r, i, c] = -pair.hessian[..., r, c]
        size = d * (self.n + 1)
        return Expansion(pair.energy.sum(-1), gradient, H.reshape(*batch, size, size))


@dataclass(frozen=True, eq=False)
class PredictedPairs(Residual):
    """A potential between the robot and people who are held at their prediction.

    Variable: robot (positions first).

    Args:
        potential: What a pair is worth.
        people: Predicted positions, shape (n, 2), or (S, n, 2) where they differ by step [m].
        robot_dim: Size of the robot's variable.
    """

    per_step: ClassVar[tuple[str, ...]] = ("people",)

    potential: PairPotential
    people: Array
    robot_dim: int = 4

    @cached_property
    def dims(self) -> tuple[int, ...]:
        return (self.robot_dim,)

    @property
    def rows(self) -> int:
        return int(self.people.shape[-2])

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.arange(self.people.shape[-1])

    def at(self, step: int) -> Self:
        if self.people.ndim == 2:
            return self
        return replace(self, people=self.people[step], potential=self.potential.at(step))

    def _separations(self, robot: Array) -> Array:
        return np.asarray(robot[..., None, : self.people.shape[-1]] - self.people)

    def energy(self, *x: Array) -> Array:
        return np.asarray(self.potential.energy(self._separations(*x)).sum(-1))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        e, slope = self.potential.linearize(self._separations(*x))
        J = np.zeros((*e.shape, self.robot_dim))
        J[..., : self.people.shape[-1]] = slope
        return e, (J,)

    def expand(self, *x: Array) -> Expansion:
        return _total(self.potential.expand(self._separations(*x)))

    def gauss_newton(self, *x: Array) -> Expansion:
        return _total(self.potential.gauss_newton(self._separations(*x)))


def pair_index(n: int, pairs: Literal["all", "robot"]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bodies i < j of every pair among a robot (body 0) and n people."""
    if n < 1:
        raise ValueError(f"an interaction needs at least one person, got n = {n}")
    if pairs == "robot":
        return np.zeros(n, dtype=np.intp), np.arange(1, n + 1)
    i, j = np.triu_indices(n + 1, k=1)
    return i, j


def _total(pair: Expansion) -> Expansion:
    return Expansion(pair.energy.sum(-1), pair.gradient.sum(-2), pair.hessian.sum(-3))
