"""What is known now: robot, goal, map, people seen so far, and the parameters of the density."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fgplan.holonomic import Holonomic
from fgplan.robots import RobotModel

if TYPE_CHECKING:
    from fgplan.measuring import Measurement
    from fgplan.mission import Mission
    from fgplan.occupancy import OccupancyGrid
    from fgplan.regions import Region

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Robot:
    """A disc, how it moves, and its state now.

    Args:
        position: Shape (2,) [m], map frame.
        velocity: Shape (2,) [m/s]; of a robot with wheels the part along its heading counts.
        heading: [rad] counter-clockwise from x; None means the direction of motion (or of the
            goal, when standing).
        yaw_rate: [rad/s], of a robot with wheels.
        covariance: Of the model's state, (x, y, vx, vy) or (x, y, θ, v, ω), shape (4, 4) or
            (5, 5); None means that the state is exact.
        radius: [m].
        preferred_speed: Cruise speed of a global plan [m/s].
        max_speed: [m/s].
        max_acceleration: [m/s²].
        model: How it moves: `Holonomic`, `DifferentialDrive`, `CarLike`, or a model of yours.
    """

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(2))
    heading: float | None = None
    yaw_rate: float = 0.0
    covariance: Array | None = None
    radius: float = 0.25
    preferred_speed: float = 1.0
    max_speed: float = 1.2
    max_acceleration: float = 1.5
    model: RobotModel = field(default_factory=Holonomic)

    @property
    def state(self) -> Array:
        """(x, y, vx, vy)."""
        return np.concatenate([self.position, self.velocity])


@dataclass(frozen=True, eq=False)
class Track:
    """Where one person was seen. Gaps and any sampling are fine; one position is enough.

    Args:
        identity: Name of the person, unique in a scenario.
        times: Shape (m,) [s], increasing, none after the scenario's `now`.
        positions: Shape (m, 2) [m].
        radius: Of the person's disc [m].
    """

    identity: str
    times: Array
    positions: Array
    radius: float = 0.3


@dataclass(frozen=True)
class FieldOfView:
    """What the robot can see: who is outside is not in the density at all.

    Args:
        range: [m].
        angle: Full opening angle [rad], centred on the robot's heading; 2π sees all round.
        occlusion: Whether obstacles of the map hide people behind them.
    """

    range: float = np.inf
    angle: float = 2 * np.pi
    occlusion: bool = True


@dataclass(frozen=True, eq=False)
class GivenPlan:
    """A global plan that the user states instead of, or beside, the generated ones.

    Args:
        label: Its name in every table.
        path: Vertices, shape (N, 2) [m]; the first is where the robot is, or else a straight line
            from there is put before it. What of it the map does not allow, the hard check refuses.
        weight: w_i, any positive number on the scale of the other given plans; None means that
            the weight comes from the path's cost like a generated plan's.
    """

    label: str
    path: Array
    weight: float | None = None


@dataclass(frozen=True)
class Level:
    """One planning level η_l of the stack, from the mission (first) to those next to the robot.

    Args:
        name: For tables and pictures.
        sigma: Standard deviation of η_l around its mean [m]: the width of the corridor it may
            use. 0 is the paper's δ: the level is then the fixed path and not a variable. Its mean
            is the global plan, or the level's own. `inf`, from the second level on, is no prior
            of its own: it follows the level above.
        length: Correlation time of that deviation [s].
        h: Variance of its coupling to each level that follows it, or to the robot [m²].
        Qc: Power spectral density of its acceleration where sigma is `inf` [m²/s³]: it is smooth;
            None: it is flat, nothing is said of it but by couplings and data.
        follows: Name of the level that guides it; None: the one before it. A level that several
            follow makes the stack a tree; levels that nobody follows guide the robot.
        every: Its time resolution: it meets the levels beside it at every so many-th step of the
            density, with the exponent of that many steps. In between it is its own process, which
            integrates out exactly.
        plans: Its own discrete hypotheses beside those of the first level: the mean is one of
            these plans. All combinations over the levels compete.
    """

    name: str = "mission"
    sigma: float = 0.0
    length: float = 4.0
    h: float = 1.0
    Qc: float | None = None
    follows: str | None = None
    every: int = 1
    plans: tuple[GivenPlan, ...] = ()


@dataclass(frozen=True)
class Density:
    """Parameters of the joint density; `docs/conventions.md` says where the defaults come from.

    Args:
        dt: Time between two states [s].
        horizon: [s]; the number of steps is horizon/dt, rounded.
        t_ref: Potentials carry the exponent dt/t_ref [s], so that a decision does not depend on
            dt; None means t_ref = dt, the paper's plain product over steps.
        Qc_robot: Power spectral density of the robot's acceleration [m²/s³].
        Qc_people: The same for people [m²/s³].
        sigma_track: Standard deviation of a tracked position [m].
        sigma_speed: Prior standard deviation of a person's velocity [m/s].
        alpha: Strength of the interaction, in [0, 1].
        h_c: Its length [m].
        contact_sigma: Of the contact hinge [m]; inf switches the hinge off.
        contact_margin: ε of the contact hinge [m], beyond the two radii.
        obstacle_sigma: Of the obstacle hinge [m]; inf switches it off.
        obstacle_margin: ε of the obstacle hinge [m], beyond the robot's radius.
        limit_sigma: Of the speed [m/s] and acceleration [m/s²] hinges; inf switches them off.
        reach: Who stays further than this from every start of the robot is held at their
            prediction also when people are planned jointly [m]; inf plans everybody.
        beta: Nats per second of cost to go: w = softmax(−beta J).
    """

    dt: float = 0.4
    horizon: float = 4.8
    t_ref: float | None = 0.4
    Qc_robot: float = 2.0
    Qc_people: float = 0.029
    sigma_track: float = 0.043
    sigma_speed: float = 1.5
    alpha: float = 0.99
    h_c: float = 0.36
    contact_sigma: float = 0.1
    contact_margin: float = 0.2
    obstacle_sigma: float = 0.1
    obstacle_margin: float = 0.1
    limit_sigma: float = 0.05
    reach: float = 3.0
    beta: float = 0.7

    @property
    def steps(self) -> int:
        """Number of steps T; a trajectory has T + 1 states."""
        return max(1, round(self.horizon / self.dt))

    @property
    def times(self) -> Array:
        """t_k = k·dt, shape (T + 1,) [s]; 0 is now."""
        return np.asarray(self.dt * np.arange(self.steps + 1), dtype=float)

    @property
    def exponent(self) -> float:
        """dt/t_ref, the power of every per-step potential."""
        return 1.0 if self.t_ref is None else self.dt / self.t_ref


@dataclass(frozen=True, eq=False)
class Scenario:
    """Everything a plan depends on.

    Args:
        robot: The robot now.
        goal: Shape (2,) [m]; None means that no goal is known.
        goal_speed: Speed at which the goal is passed [m/s]; 0: the robot comes to rest there.
        grid: The map; None is open space without limits.
        tracks: The people seen so far.
        now: Time of the robot's state on the clock of the tracks [s].
        field_of_view: None sees everybody.
        plans: Global plans given by the user.
        count: How many global plans to generate beside them; 0 for none.
        crowd: "joint" plans the people with the robot, "predicted" holds them at their
            prediction.
        pairs: Who interacts: "all" or only the "robot" with each person.
        levels: The stack of planning levels, mission first.
        density: Parameters.
        name: For tables and pictures.
        data: What measures the levels or the robot: operator data, waypoints, tactical data
            (`fgplan.measuring`), on the clock of `now`. Empty is nobody who intervenes.
        regions: Places with names, for missions and tactical data.
        mission: What is asked over the regions, and how far it is done; with it `goal` is where
            to go when it is done, and may be None.
    """

    robot: Robot
    goal: Array | None = None
    goal_speed: float = 0.0
    grid: OccupancyGrid | None = None
    tracks: tuple[Track, ...] = ()
    now: float = 0.0
    field_of_view: FieldOfView | None = None
    plans: tuple[GivenPlan, ...] = ()
    count: int = 3
    crowd: Literal["joint", "predicted"] = "joint"
    pairs: Literal["all", "robot"] = "all"
    levels: Sequence[Level] = (Level(),)
    density: Density = Density()
    name: str = "scenario"
    data: tuple[Measurement, ...] = ()
    regions: tuple[Region, ...] = ()
    mission: Mission | None = None

    @classmethod
    def load(cls, path: str | Path) -> Scenario:
        """Read a scenario file (TOML).

        Raises:
            ScenarioError: the file is missing, is not TOML, its map cannot be read, or it says
                something that cannot be planned; all mistakes are reported at once.
        """
        from fgplan.scenario_file import load  # pydantic only when a file is read

        return load(Path(path))

    def replace(self, **changes: Any) -> Scenario:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)
