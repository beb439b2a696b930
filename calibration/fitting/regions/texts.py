"""Drawn regions as people write them: a TOML file, or a text on the command line.

    [[regions]]
    name = "logo"
    kind = "ignore"
    points_mm = [[3.1, 4.0], [6.2, 4.0], [6.2, 7.5]]

`stricter` has a `factor` too. On the command line the same is `ignore logo 3.1,4 6.2,4 6.2,7.5`, and a stricter one
`stricter seam 1.5 2,2 8,2 8,4`.
"""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from edge.core.drawn_regions import DrawnRegion
from edge.core.errors import ConfigError

__all__ = ["parse_region", "read_regions", "write_regions"]

_KEYS: Final = ("name", "kind", "points_mm", "factor")


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


def parse_region(text: str) -> DrawnRegion:
    """Read the region of a text. Errors: ConfigError."""
    kind, _, rest = text.strip().partition(" ")
    name, _, rest = rest.strip().partition(" ")
    words, factor = rest.split(), dict[str, float]()
    if kind == "stricter" and words and "," not in words[0]:
        factor["factor"] = _number(text, words.pop(0))
    if not words:
        raise ConfigError(f"'{text}' has no place; write 'ignore NAME x,y x,y x,y' in mm")
    points = [_point(text, word) for word in words]
    return _region(f"'{text}'", {"name": name, "kind": kind, "points_mm": points, **factor})


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


def write_regions(regions: Sequence[DrawnRegion]) -> str:
    """Write them as a file that `read_regions` reads."""
    texts = []
    for one in regions:
        points = ", ".join(f"[{x:g}, {y:g}]" for x, y in one.points_mm)
        factor = f"factor = {one.factor:g}\n" if one.kind == "stricter" else ""
        name = one.name.replace("\\", "\\\\").replace('"', '\\"')
        texts.append(f'[[regions]]\nname = "{name}"\nkind = "{one.kind}"\n{factor}points_mm = [{points}]\n')
    return "\n".join(texts)
