"""Map files of ROS map_server and Nav2: a YAML file that names an image.

The rules are those of map_server's `map_io`: https://docs.nav2.org (Map Server) and
http://wiki.ros.org/map_server. A pixel that is not opaque is unknown in mode trinary as in scale,
where Nav2 averages its alpha with the colours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgplan.errors import MapError

Array = NDArray[np.float64]

MODES = ("trinary", "scale", "raw")
REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


def read(path: Path) -> tuple[NDArray[np.int8], Any, Any]:
    """Data of a map file, and resolution and origin as they stand there.

    Raises:
        MapError: a file is missing or cannot be read, or a field is missing or wrong.
    """
    fields = _fields(path)
    occupied, free = _thresholds(path, fields)
    negate = fields["negate"]
    if negate not in (0, 1):  # True == 1: int and bool are both in use
        raise MapError(f"{path}: negate: got {negate!r}; give 0 or 1, or false or true")
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise MapError(f"{path}: mode: got {mode!r}; give one of {', '.join(MODES)}")
    shade, opaque = _image(path, fields["image"])
    if mode == "raw":
        data = np.where(shade <= 100, np.rint(shade), -1)
    else:
        p = (shade if negate else 255.0 - shade) / 255.0
        data = np.full(p.shape, -1.0)
        if mode == "scale":
            data = np.rint(100 * (p - free) / (occupied - free))
        data = np.where(p >= occupied, 100, np.where(p <= free, 0, data))
        data = np.where(opaque, data, -1)
    # The first row of an image is at the top, the first row of the map at the bottom.
    return data[::-1].astype(np.int8), fields["resolution"], fields["origin"]


def write(path: Path, data: NDArray[np.int8], resolution: float, origin: Array) -> None:
    """Write the YAML file and a PGM image beside it, such that `read` gives back the same data.

    A map of nothing but free, occupied and unknown is written as map_saver does (254, 0, 205);
    any other one in mode raw, where 255 is unknown.
    """
    import yaml
    from PIL import Image

    trinary = bool(np.isin(data, (-1, 0, 100)).all())
    if trinary:
        shade = np.select([data == 0, data == 100], [254, 0], default=205)
    else:
        shade = np.where(data < 0, 255, data)
    image = path.with_suffix(".pgm")
    Image.fromarray(shade.astype(np.uint8)[::-1]).save(image)
    fields = {
        "image": image.name,
        "mode": "trinary" if trinary else "raw",
        "resolution": float(resolution),
        "origin": [float(value) for value in origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,  # 205 gives 0.19608: with 0.25 unknown would come back as free
    }
    path.write_text(yaml.safe_dump(fields, sort_keys=False), encoding="utf-8")


def _fields(path: Path) -> dict[str, Any]:
    """The YAML file's mapping, with all required fields."""
    import yaml

    try:
        fields = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(
            f"{path}: got {error.strerror}; give the path of a map's YAML file"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise MapError(f"{path}: got {error}; give a YAML file as map_server writes it") from error
    if not isinstance(fields, dict):
        raise MapError(f"{path}: got {fields!r}; give the fields {', '.join(REQUIRED)}")
    missing = [name for name in REQUIRED if name not in fields]
    if missing:
        raise MapError(f"{path}: got no {', '.join(missing)}; add every missing field")
    return fields


def _thresholds(path: Path, fields: dict[str, Any]) -> tuple[float, float]:
    occupied = _number(path, fields, "occupied_thresh")
    free = _number(path, fields, "free_thresh")
    for name, value in (("occupied_thresh", occupied), ("free_thresh", free)):
        if not 0 <= value <= 1:
            raise MapError(f"{path}: {name}: got {value}; give a probability from 0 to 1")
    if occupied <= free:
        raise MapError(
            f"{path}: occupied_thresh: got {occupied}; give more than free_thresh, which is {free}"
        )
    return occupied, free


def _number(path: Path, fields: dict[str, Any], name: str) -> float:
    value = fields[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MapError(f"{path}: {name}: got {value!r}; give a number")
    return float(value)


def _image(path: Path, name: Any) -> tuple[Array, NDArray[np.bool_]]:
    """Shade 0 to 255 of each pixel (colours averaged) and whether it is opaque."""
    from PIL import Image

    if not isinstance(name, str) or not name:
        raise MapError(f"{path}: image: got {name!r}; give the image's path")
    place = path.parent / name
    if not place.is_file():
        raise MapError(f"{path}: image: got {name!r}, no such file; give a path beside the YAML")
    try:
        with Image.open(place) as picture:
            if picture.mode in ("I", "I;16", "I;16B", "F"):
                raise MapError(f"{path}: image: got {name!r} of mode {picture.mode}; give 8 bits")
            pixels = np.asarray(picture.convert("RGBA"), dtype=float)
    except MapError:
        raise
    except (OSError, ValueError, SyntaxError) as error:
        raise MapError(f"{path}: image: got {name!r}, {error}; give a PGM or PNG image") from error
    return pixels[..., :3].mean(axis=-1), pixels[..., 3] >= 255
