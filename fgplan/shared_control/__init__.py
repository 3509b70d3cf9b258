"""Shared control: what an operator says, as data of the density, and what it leads to."""

from fgplan.shared_control.admission import Admitted, admit
from fgplan.shared_control.candidates import Candidate, find_candidates, toward
from fgplan.shared_control.joystick import JoySample, Joystick, Stick, read_joy, write_joy
from fgplan.shared_control.pointing import (
    ON,
    STICK,
    VIA,
    Lead,
    operated,
    path_via,
    pointed,
    waypoints,
)
from fgplan.shared_control.waypoint import DrawnPath, Waypoint
from fgplan.shared_control.wish import Deviation, deviation

__all__ = [
    "ON",
    "STICK",
    "VIA",
    "Admitted",
    "Candidate",
    "Deviation",
    "DrawnPath",
    "JoySample",
    "Joystick",
    "Lead",
    "Stick",
    "Waypoint",
    "admit",
    "deviation",
    "find_candidates",
    "operated",
    "path_via",
    "pointed",
    "read_joy",
    "toward",
    "waypoints",
    "write_joy",
]
