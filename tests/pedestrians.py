"""Where the recorded pedestrians are: they are no part of the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data" / "pedestrians"

FOLDER = Path(os.environ.get("FGPLAN_PEDESTRIANS", _DEFAULT))

needs_recordings = pytest.mark.skipif(
    not (FOLDER / "cases.csv").is_file(),
    reason="no recorded pedestrians here; FGPLAN_PEDESTRIANS names their folder",
)
