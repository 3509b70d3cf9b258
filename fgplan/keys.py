"""The only speller of GTSAM keys: one variable per time step and trajectory."""

from __future__ import annotations

import re

import gtsam

_STEPS = 1_000_000  # time steps per level inside one 48-bit symbol index


def robot(k: int) -> int:
    """f^R at step k: (x, y, vx, vy)."""
    return int(gtsam.symbol("r", k))


def crowd(k: int) -> int:
    """f at step k: all n positions, then all n velocities."""
    return int(gtsam.symbol("c", k))


def level(index: int, k: int) -> int:
    """η_index at step k: (x, y, vx, vy)."""
    return int(gtsam.symbol("e", index * _STEPS + k))


def name(key: int) -> str:
    """A readable name: robot(3), crowd(3), level(0, 3); GTSAM's own for any other key."""
    symbol = gtsam.Symbol(key)
    kind, index = chr(symbol.chr()), symbol.index()
    if kind == "r":
        return f"robot({index})"
    if kind == "c":
        return f"crowd({index})"
    if kind == "e":
        return f"level({index // _STEPS}, {index % _STEPS})"
    return str(symbol.string())


def step(key: int) -> int | None:
    """The time step of a key, None for a key that is not ours."""
    found = re.fullmatch(r"(?:robot|crowd|level)\((?:\d+, )?(\d+)\)", name(key))
    return int(found[1]) if found else None
