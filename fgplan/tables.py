"""What the tables of scenario files are made of."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Strict

Number = Annotated[float, Strict()]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
Point = tuple[Number, Number]


class Table(BaseModel):
    """A table whose keys are all known."""

    model_config = ConfigDict(extra="forbid")

    def stated(self) -> dict[str, Any]:
        """What the file says, without what it leaves at the defaults of `fgplan.scenario`."""
        return {name: getattr(self, name) for name in self.model_fields_set}
