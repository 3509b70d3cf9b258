"""Missions: formulas over the regions of a map, and the ways to do what they ask."""

from fgplan.mission.evaluator import satisfies
from fgplan.mission.itinerary import Itinerary, Rules, itineraries, rules
from fgplan.mission.mission import Fact, Mission

__all__ = ["Fact", "Itinerary", "Mission", "Rules", "itineraries", "rules", "satisfies"]
