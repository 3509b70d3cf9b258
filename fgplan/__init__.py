"""fgplan: planning for robots among people as inference on a factor graph."""

from fgplan.errors import FgplanError, MapError, MissionError, NoPlan, NoRoute, ScenarioError
from fgplan.holonomic import Holonomic
from fgplan.measuring import Measurement, Reading, Readings
from fgplan.mission import Fact, Mission
from fgplan.mixture import Action, Component, Mixture
from fgplan.occupancy import OccupancyGrid
from fgplan.planner import plan
from fgplan.regions import Region
from fgplan.robots import RobotModel, Twist
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
    "Fact",
    "FgplanError",
    "FieldOfView",
    "GivenPlan",
    "GtsamLM",
    "Holonomic",
    "Level",
    "MapError",
    "Measurement",
    "Mission",
    "MissionError",
    "Mixture",
    "NoPlan",
    "NoRoute",
    "OccupancyGrid",
    "Reading",
    "Readings",
    "Region",
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
