"""What the time of a plan is spent on."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple, Self

import numpy as np

ROUTES = 0.2
"""Share of a deadline after which no further routes are looked for."""
RESERVE = 0.2
"""Share of a deadline that is kept for checking and weighing what was found."""


class Deadline(NamedTuple):
    """When what of a plan is over, on the clock of `time.perf_counter` [s]; inf without a deadline.

    Args:
        began: The plan.
        routes: Looking for routes.
        solving: The solver.
        weighing: Beginning with evidence: what is left must do for the check and the action.
        end: Everything.
    """

    began: float
    routes: float
    solving: float
    weighing: float
    end: float

    @classmethod
    def until(cls, deadline: float | None) -> Self:
        """From now until a deadline [s].

        Raises:
            ValueError: it is negative, or no number.
        """
        now, given = perf_counter(), np.inf if deadline is None else deadline
        if not given >= 0:
            raise ValueError(f"deadline must be a number of seconds, 0 or above, got {deadline}")
        shares = ROUTES, 1 - RESERVE, 1 - 0.5 * RESERVE, 1.0
        return cls(now, *(now + share * given for share in shares))
