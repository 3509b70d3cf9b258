"""Shared control: what an operator says, as data of the density, and what it leads to."""

from fgplan.shared_control.admission import Admitted, admit
from fgplan.shared_control.candidates import Candidate, find_candidates, toward
from fgplan.shared_control.joystick import JoySample, Joystick, Stick, read_joy, write_joy
from fgplan.shared_control.pointing import operated, pointed
from fgplan.shared_control.waypoint import DrawnPath, Waypoint
from fgplan.shared_control.wish import Deviation, deviation

__all__ = [
    "Admitted",
    "Candidate",
    "Deviation",
    "DrawnPath",
    "JoySample",
    "Joystick",
    "Stick",
    "Waypoint",
    "admit",
    "deviation",
    "find_candidates",
    "operated",
    "pointed",
    "read_joy",
    "toward",
    "write_joy",
]
