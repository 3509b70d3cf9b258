"""fgplan: planning for robots among people as inference on a factor graph."""

from fgplan.errors import FgplanError, MapError, NoPlan, NoRoute, ScenarioError
from fgplan.measuring import Measurement, Reading, Readings
from fgplan.mixture import Action, Component, Mixture
from fgplan.occupancy import OccupancyGrid
from fgplan.planner import plan
from fgplan.robots import Holonomic, RobotModel, Twist
from fgplan.scenario import Density, FieldOfView, GivenPlan, Level, Robot, Scenario, Track
from fgplan.solver import GtsamLM, SecondOrder
from fgplan.trajectory import Trajectory
from fgplan.wheeled import CarLike, DifferentialDrive

__version__ = "0.1.0"

__all__ = [
    "Action",
    "CarLike",
    "Component",
    "Density",
    "DifferentialDrive",
    "FgplanError",
    "FieldOfView",
    "GivenPlan",
    "GtsamLM",
    "Holonomic",
    "Level",
    "MapError",
    "Measurement",
    "Mixture",
    "NoPlan",
    "NoRoute",
    "OccupancyGrid",
    "Reading",
    "Readings",
    "Robot",
    "RobotModel",
    "Scenario",
    "ScenarioError",
    "SecondOrder",
    "Track",
    "Trajectory",
    "Twist",
    "plan",
]
