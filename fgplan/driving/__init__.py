"""Driving: what is seen now goes in, what to do now comes out, many times a second."""

from fgplan.driving.observation import Decision, Detection, Observation, Outcome

__all__ = ["Decision", "Detection", "Observation", "Outcome"]
