"""Potentials between pairs of bodies: all pairs of a time step, and all time steps, in one call.

A potential is a function of the squared distance of two bodies Δ = p_i − p_j, so three numbers a
pair make its expansion (`radial.py`). A wiring says which bodies are variables. `interaction.py`
and `contact.py` hold the potentials.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import ClassVar, Literal, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factors.radial import Radial, square
from factors.residual import Array, Expansion, Residual

_SUM = "...p,...p->..."
"""Sum over pairs of a product."""


class ByPair(NamedTuple):
    """An expansion whose Hessian is kept pair by pair: energy (...), gradient (..., s), and the
    block (xx, xy, yy) of Δ = p_i − p_j of each pair, shape (..., P, 3)."""

    energy: Array
    gradient: Array
    blocks: Array


@runtime_checkable
class PairTerm(Protocol):
    """A residual that can be expanded pair by pair: bodies i < j of each pair, shape (P,)."""

    @property
    def i(self) -> NDArray[np.intp]: ...

    @property
    def j(self) -> NDArray[np.intp]: ...

    def by_pair(self, *x: Array, flat: bool = False) -> ByPair:
        """The expansion; with `flat`, Gauss–Newton's."""
        ...


class PairPotential(ABC):
    """An energy of the squared distance d2 of two bodies, shape (..., P) for P pairs."""

    @abstractmethod
    def energy(self, d2: Array) -> Array:
        """−log of the potential, shape (..., P)."""

    @abstractmethod
    def linearize(self, d2: Array) -> tuple[Array, Array]:
        """Whitened error e (..., P), energy ½e², and c (..., P) with ∂e/∂Δ = c·Δ."""

    @abstractmethod
    def expand(self, d2: Array) -> Radial:
        """Energy with its true curvature."""

    def gauss_newton(self, d2: Array) -> Radial:
        """The same with the Gauss–Newton Hessian, which is positive semidefinite."""
        e, c = self.linearize(d2)
        return Radial(0.5 * e**2, e * c, 0.0, c**2)

    def at(self, step: int) -> Self:
        """This potential with the parameters of one time step."""
        return self


@dataclass(frozen=True)
class Together(PairPotential):
    """Several potentials of the same pairs, so that their distances are computed once.

    It is for solvers that ask for expansions; the error of a sum of energies is no single number
    with a slope, so GTSAM sees one factor a potential.

    Args:
        potentials: At least one.
    """

    potentials: tuple[PairPotential, ...]

    def energy(self, d2: Array) -> Array:
        return reduce(np.add, [potential.energy(d2) for potential in self.potentials])

    def linearize(self, d2: Array) -> tuple[Array, Array]:
        raise TypeError("linearize the potentials one by one: their sum is no square")

    def expand(self, d2: Array) -> Radial:
        return reduce(Radial.plus, [potential.expand(d2) for potential in self.potentials])

    def gauss_newton(self, d2: Array) -> Radial:
        return reduce(Radial.plus, [potential.gauss_newton(d2) for potential in self.potentials])


@dataclass(frozen=True, eq=False)
class CrowdPairs(Residual):
    """A potential between the robot and n people, and between people, all of them variables.

    Variables: robot (positions first), crowd (n positions, then anything).

    Args:
        potential: What a pair is worth.
        n: Number of people, at least 1.
        pairs: "all", or only the "robot" with each person; or bodies i < j of each pair, shape
            (P, 2), the robot being body 0.
        robot_dim: Size of the robot's variable.
        space: Number of coordinates of a position.
    """

    potential: PairPotential
    n: int
    pairs: Literal["all", "robot"] | NDArray[np.intp] = "all"
    robot_dim: int = 4
    space: int = 2

    @cached_property
    def dims(self) -> tuple[int, ...]:
        return (self.robot_dim, 2 * self.space * self.n)

    @cached_property
    def index(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Bodies i < j of each pair; the robot is body 0."""
        if isinstance(self.pairs, str):
            return pair_index(self.n, self.pairs)
        i, j = self.pairs.T
        return i, j

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

    def _separations(self, robot: Array, crowd: Array) -> list[Array]:
        """Δ of all pairs, one array (..., P) per coordinate."""
        i, j = self.index
        apart = []
        for c in range(self.space):
            people = crowd[..., c : self.space * self.n : self.space]
            bodies = np.concatenate([robot[..., c : c + 1], people], axis=-1)
            apart.append(bodies.take(i, axis=-1) - bodies.take(j, axis=-1))
        return apart

    def energy(self, *x: Array) -> Array:
        return np.asarray(self.potential.energy(square(self._separations(*x))).sum(-1))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        delta = self._separations(*x)
        e, c = self.potential.linearize(square(delta))
        slope = np.stack([c * d for d in delta], axis=-1)
        J = self._incidence[:, :, None] * slope[..., :, None, :]
        J_robot = np.zeros((*e.shape, self.dims[0]))
        J_crowd = np.zeros((*e.shape, self.dims[1]))
        J_robot[..., : self.space] = J[..., 0, :]
        J_crowd[..., : self.space * self.n] = J[..., 1:, :].reshape(*e.shape, -1)
        return e, (J_robot, J_crowd)

    def expand(self, *x: Array) -> Expansion:
        delta = self._separations(*x)
        return self._gather(delta, self.potential.expand(square(delta)))

    def gauss_newton(self, *x: Array) -> Expansion:
        delta = self._separations(*x)
        return self._gather(delta, self.potential.gauss_newton(square(delta)))

    def _gather(self, delta: list[Array], pair: Radial) -> Expansion:
        """Pairs (..., P) as one expansion of all bodies."""
        batch, d = pair.energy.shape[:-1], self.space
        gradient = np.empty((*batch, self.n + 1, d))
        H = np.zeros((*batch, self.n + 1, d, self.n + 1, d))
        i, j = self.index
        body, both = np.arange(self.n + 1), np.abs(self._incidence)
        for r in range(d):
            gradient[..., r] = (pair.slope * delta[r]) @ self._incidence
            for c in range(r + 1):
                h = pair.b * delta[r] * delta[c]
                if r == c:
                    h += pair.a
                # Bodies (i, j) of a pair get +h on the diagonal and −h beside it.
                own = h @ both
                np.negative(h, out=h)
                for row, column in {(r, c), (c, r)}:
                    H[..., body, row, body, column] = own
                    H[..., i, row, j, column] = h
                    H[..., j, row, i, column] = h
        size = d * (self.n + 1)
        return Expansion(
            pair.energy.sum(-1), gradient.reshape(*batch, size), H.reshape(*batch, size, size)
        )


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

    @property
    def _space(self) -> int:
        return int(self.people.shape[-1])

    @cached_property
    def support(self) -> NDArray[np.intp]:
        return np.arange(self._space)

    def at(self, step: int) -> Self:
        if self.people.ndim == 2:
            return self
        return replace(self, people=self.people[step], potential=self.potential.at(step))

    @cached_property
    def _coordinates(self) -> list[Array]:
        return [np.ascontiguousarray(self.people[..., c]) for c in range(self._space)]

    def _separations(self, robot: Array) -> list[Array]:
        return [robot[..., c, None] - people for c, people in enumerate(self._coordinates)]

    def energy(self, *x: Array) -> Array:
        return np.asarray(self.potential.energy(square(self._separations(*x))).sum(-1))

    def linearize(self, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        delta = self._separations(*x)
        e, c = self.potential.linearize(square(delta))
        J = np.zeros((*e.shape, self.robot_dim))
        for r, d in enumerate(delta):
            J[..., r] = c * d
        return e, (J,)

    def expand(self, *x: Array) -> Expansion:
        delta = self._separations(*x)
        return self._total(delta, self.potential.expand(square(delta)))

    def gauss_newton(self, *x: Array) -> Expansion:
        delta = self._separations(*x)
        return self._total(delta, self.potential.gauss_newton(square(delta)))

    def _total(self, delta: list[Array], pair: Radial) -> Expansion:
        """The sum over people, as an expansion in the robot's position."""
        shape, d = pair.energy.shape[:-1], self._space
        gradient, H = np.empty((*shape, d)), np.empty((*shape, d, d))
        a = np.add.reduce(pair.a + np.zeros(self.rows), axis=-1)
        for r in range(d):
            np.einsum(_SUM, pair.slope, delta[r], out=gradient[..., r])
            weighted = pair.b * delta[r]
            for c in range(r):
                H[..., r, c] = H[..., c, r] = np.einsum(_SUM, weighted, delta[c])
            np.add(np.einsum(_SUM, weighted, delta[r]), a, out=H[..., r, r])
        return Expansion(np.add.reduce(pair.energy, axis=-1), gradient, H)


def pair_index(n: int, pairs: Literal["all", "robot"]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bodies i < j of every pair among a robot (body 0) and n people."""
    if n < 1:
        raise ValueError(f"an interaction needs at least one person, got n = {n}")
    if pairs == "robot":
        return np.zeros(n, dtype=np.intp), np.arange(1, n + 1)
    i, j = np.triu_indices(n + 1, k=1)
    return i, j
