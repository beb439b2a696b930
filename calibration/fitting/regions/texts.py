"""Drawn regions as people write them: a TOML file, a text on the command line, or a mask as a picture.

    [[regions]]
    name = "logo"
    kind = "ignore"
    points_mm = [[3.1, 4.0], [6.2, 4.0], [6.2, 7.5]]

`stricter` has a `factor` too. On the command line the same is `ignore logo 3.1,4 6.2,4 6.2,7.5`, and a stricter one
`stricter seam 1.5 2,2 8,2 8,4`; the path of a mask takes the place of the points. In a mask what is black is outside.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from edge.core.drawn_regions import DrawnRegion, Points
from edge.core.errors import ConfigError
from edge.core.imaging.image_bytes import picture_size
from edge.model.bundle import Bundle

__all__ = ["parse_region", "read_regions", "write_regions"]

_KEYS: Final = ("name", "kind", "points_mm", "factor")
# A mask's outline keeps its corners to this, pixels.
_SMOOTHED_PX: Final = 1.0


def read_regions(path: Path) -> list[DrawnRegion]:
    """Read a file of regions. Errors: ConfigError."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; name a TOML file of regions") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} is no TOML file: {error}; `gelgate bundle regions` prints one") from error
    tables = content.get("regions")
    if set(content) != {"regions"} or not isinstance(tables, list):
        raise ConfigError(f"{path} has {sorted(content) or 'nothing'}, expected tables [[regions]] alone")
    return [_region(path, table) for table in tables]


def _region(where: object, table: Any) -> DrawnRegion:
    if not isinstance(table, Mapping) or (unknown := sorted(table.keys() - {*_KEYS})):
        found = table if not isinstance(table, Mapping) else unknown[0]
        raise ConfigError(f"{where}: a region has {', '.join(_KEYS)}, found '{found!s:.60}'")
    if missing := [key for key in _KEYS[:3] if key not in table]:
        raise ConfigError(f"{where}: a region lacks {missing[0]}; it has {', '.join(_KEYS)}")
    try:
        points = tuple((float(x), float(y)) for x, y in table["points_mm"])
        return DrawnRegion(str(table["name"]), table["kind"], points, float(table.get("factor", 1.0)))
    except (TypeError, ValueError) as error:
        why = (
            str(error)
            if str(error).startswith(("region", "a region"))
            else f"points_mm are [x, y] in mm ({error})"
        )
        raise ConfigError(f"{where}: {why}") from error


def parse_region(text: str, bundle: Bundle) -> list[DrawnRegion]:
    """Read the regions of a text: one, or one for each place of a mask. Errors: ConfigError."""
    kind, _, rest = text.strip().partition(" ")
    name, _, rest = rest.strip().partition(" ")
    words, factor = rest.split(), dict[str, float]()
    if kind == "stricter" and words and "," not in words[0]:
        factor["factor"] = _number(text, words.pop(0))
    if not words:
        raise ConfigError(
            f"'{text}' has no place; write 'ignore NAME x,y x,y x,y' in mm, or the path of a mask"
        )
    if len(words) == 1 and "," not in words[0]:
        outlines = list(_outlines(Path(words[0]), bundle))
    else:
        outlines = [tuple(_point(text, word) for word in words)]
    names = [name, *(f"{name} {k}" for k in range(2, len(outlines) + 1))]
    tables = (
        {"name": one, "kind": kind, "points_mm": at, **factor}
        for one, at in zip(names, outlines, strict=True)
    )
    return [_region(f"'{text}'", table) for table in tables]


def _point(text: str, word: str) -> tuple[float, float]:
    x, comma, y = word.partition(",")
    if not comma:
        raise ConfigError(f"'{text}': found '{word}', expected a point as x,y in mm")
    return _number(text, x), _number(text, y)


def _number(text: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigError(f"'{text}': found '{word}', expected a number; points are x,y in mm") from None


def _outlines(path: Path, bundle: Bundle) -> Iterator[Points]:
    """Yield the outline of each place of a mask, in mm. Errors: ConfigError for a picture that is no mask."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"mask {path} cannot be read: {error.strerror}; name a picture") from error
    whole, (h, w), found = bundle.profile.size, bundle.manifest.frame, picture_size(data)
    picture = (
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if found in (whole, (w, h)) else None
    )
    if picture is None:
        raise ConfigError(
            f"mask {path} is {'x'.join(map(str, found)) if found else 'no picture'}, expected a PNG of the inspected "
            f"region, {w}x{h}, or of the complete picture, {whole[0]}x{whole[1]}"
        )
    if found != (w, h):
        picture = bundle.region.crop(np.asarray(picture, np.uint8))
    inside = (picture.max(axis=2) > 0).astype(np.uint8)
    grown = cv2.resize(
        inside, (2 * w, 2 * h), interpolation=cv2.INTER_NEAREST
    )  # a line of pixels has an area then
    contours, tree = cv2.findContours(grown, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if not contours:
        raise ConfigError(f"mask {path} is black everywhere, so it names no place; draw it white")
    if (tree[0, :, 3] >= 0).any():
        raise ConfigError(f"mask {path} has a hole, which a polygon cannot have; fill it, or draw two places")
    for contour in contours:
        corners = (cv2.approxPolyDP(contour, _SMOOTHED_PX, True)[:, 0] + 0.5) / 2
        yield tuple((float(x), float(y)) for x, y in np.round(corners * bundle.profile.mm_per_pixel, 3))


def write_regions(regions: Sequence[DrawnRegion]) -> str:
    """Write them as a file that `read_regions` reads."""
    texts = []
    for one in regions:
        points = ", ".join(f"[{x:g}, {y:g}]" for x, y in one.points_mm)
        factor = f"factor = {one.factor:g}\n" if one.kind == "stricter" else ""
        name = one.name.replace("\\", "\\\\").replace('"', '\\"')
        texts.append(f'[[regions]]\nname = "{name}"\nkind = "{one.kind}"\n{factor}points_mm = [{points}]\n')
    return "\n".join(texts)
