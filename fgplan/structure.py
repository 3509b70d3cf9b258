"""The structure of a scenario file, by pydantic: what cannot be read is reported and replaced.

So that a mistake in one place does not hide those in another, stand-ins are numbers that are not
finite, which nothing mistakes for a value.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from fgplan.errors import Mistake

File = TypeVar("File", bound=BaseModel)

_ROWS = {"track": (1, 3), "path": (1, 2), "polygon": (1, 2), "polygons": (2, 2)}
"""Lists of rows: how deep the rows are, and how long."""

_TABLES = {"people", "given", "levels", "data", "regions", "facts", "plans", "tactics"}
"""Lists of tables: one that cannot be read becomes an empty one."""

_UNREADABLE: dict[str, Any] = {
    "position": [np.nan, np.nan],
    "track": [[np.nan] * 3],
    "path": [[np.nan, np.nan]] * 2,
    "robot": {"position": [np.nan, np.nan]},
}
"""Stand-ins for required values that are missing or cannot be read."""

_MENDS = {
    "missing": "is missing; give it",
    "float_type": "give a number",
    "int_type": "give a whole number",
    "string_type": 'give a text in "quotes"',
    "bool_type": "give true or false",
    "list_type": "give a list in [brackets]",
    "tuple_type": "give a list in [brackets]",
    "too_long": "has too many entries",
    "model_type": "give a table",
}


def structured(raw: Mapping[str, Any], root: type[File]) -> tuple[File, list[Mistake]]:
    """The tables of a file with their types, and what had to be replaced on the way.

    Args:
        raw: As TOML gives them.
        root: The table of the whole file.
    """
    tables = copy.deepcopy(dict(raw))
    mistakes: list[Mistake] = []
    while True:
        try:
            table = root.model_validate(tables)
            return table, list({found.path: found for found in mistakes}.values())
        except ValidationError as error:
            # Every round replaces each value that is wrong by one that is not, from the inside
            # out, so that there is an end. A missing key may follow from a value taken out.
            known = [found.path for found in mistakes]
            for issue in error.errors(include_url=False):
                loc = issue["loc"]
                found = mistake(loc, issue, root)
                if not any(overlap(found.path, path) for path in known):
                    mistakes.append(found)
                _repair(tables, loc, issue["type"])


def mistake(loc: tuple[int | str, ...], issue: Mapping[str, Any], root: type[BaseModel]) -> Mistake:
    """What pydantic found, as a mistake.

    Args:
        loc: Where, from the root.
        issue: One entry of `ValidationError.errors()`.
        root: The table of the whole file.
    """
    kind = issue["type"]
    if kind == "extra_forbidden":
        return Mistake(_spell(loc), issue["input"], _nearest(loc, root))
    if kind == "missing" and isinstance(loc[-1], int):
        return Mistake(_spell(loc[:-1]), issue["input"], "has too few entries")
    value = None if kind == "missing" else issue["input"]
    return Mistake(_spell(loc), value, _MENDS.get(kind, issue["msg"]))


def _nearest(loc: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """How to mend an unknown key."""
    for part in loc[:-1]:
        if isinstance(part, str):
            model = table_of(model.model_fields[part].annotation)
    valid = sorted(model.model_fields)
    close = get_close_matches(str(loc[-1]), valid, n=1)
    if close:
        return f"is not a key; did you mean {close[0]!r}?"
    return f"is not a key; the keys here are {', '.join(valid)}"


def table_of(annotation: Any) -> type[BaseModel]:
    """The table inside an annotation such as `list[PersonTable] | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = [arg for arg in get_args(annotation) if arg is not type(None)]
    return table_of(inner[0])


def _repair(tables: dict[str, Any], loc: tuple[int | str, ...], kind: str) -> None:
    """Take out what cannot be read, or put what nothing mistakes for a value in its place."""
    last = max(i for i, part in enumerate(loc) if isinstance(part, str))
    key = str(loc[last])
    owner: Any = tables
    for part in loc[:last]:
        owner = owner[part]
    depth, width = _ROWS.get(key, (0, 0))
    if depth and len(loc) > last + depth:
        if key not in owner:  # another mistake took it out in this round
            return
        rows = owner[key]
        for part in loc[last + 1 : last + depth]:
            rows = rows[part]
        rows[loc[last + depth]] = [np.nan] * width
    elif kind == "missing" and len(loc) == last + 1:
        # A name no other has.
        owner[key] = copy.deepcopy(_UNREADABLE.get(key, f"unnamed {_spell(loc)}"))
    elif key in _TABLES and key in owner and len(loc) > last + 1:
        owner[key][loc[last + 1]] = {}
    else:
        owner.pop(key, None)


def _spell(loc: Sequence[int | str]) -> str:
    """("people", 2, "track", 5) as people[2].track[5]."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    return "".join(parts).removeprefix(".")


def overlap(one: str, other: str) -> bool:
    """Whether one path names the same thing as the other, or a part of it."""
    short, long = sorted((one, other), key=len)
    return long.startswith(short) and long[len(short) :][:1] in ("", ".", "[")
