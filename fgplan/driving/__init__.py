"""Driving: what is seen now goes in, what to do now comes out, many times a second."""

from fgplan.driving.goals import CandidateGoals, GoalInference
from fgplan.driving.memory import Memory
from fgplan.driving.observation import Decision, Detection, Intent, Observation, Outcome
from fgplan.driving.planner import Planner
from fgplan.driving.settings import Settings

__all__ = [
    "CandidateGoals",
    "Decision",
    "Detection",
    "GoalInference",
    "Intent",
    "Memory",
    "Observation",
    "Outcome",
    "Planner",
    "Settings",
]
