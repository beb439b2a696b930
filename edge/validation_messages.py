"""What pydantic found wrong in a table that a person wrote, one sentence a fault."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from edge.core.suggest import suggestion

__all__ = ["numbered", "sentences", "types_in"]


def sentences(model: type[BaseModel], error: ValidationError, where: str = "") -> list[str]:
    """Every fault in `error`, raised by `model`, with the whole key; an unknown key comes with the nearest known one.

    where: the key of the table itself in the file that holds it. A table's own values are not repeated: one of them
    may be a secret.
    """
    faults = [dict(fault) for fault in error.errors()]
    return [_sentence(model, where, fault) for fault in faults if not _is_follower(fault, faults)]


def numbered(what: str, faults: Sequence[str]) -> str:
    """All faults of one file in one report."""
    lines = "".join(f"\n  {number}. {fault}" for number, fault in enumerate(faults, 1))
    return f"{what} has {len(faults)} fault(s):{lines}"


def _is_follower(fault: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether a list is too short by its faulty items alone, which have sentences of their own."""
    place = fault["loc"]
    return fault["type"] == "too_short" and any(
        len(other["loc"]) > len(place) and other["loc"][: len(place)] == place for other in faults
    )


def _sentence(model: type[BaseModel], where: str, fault: Mapping[str, Any]) -> str:
    key = ".".join(str(part) for part in (*([where] if where else []), *fault["loc"]))
    message = str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "extra_forbidden":
        known = _keys_at(model, fault["loc"][:-1])
        return f"'{key}' is not known; {suggestion(str(fault['loc'][-1]), known)}"
    if fault["type"] == "missing":
        return f"'{key}' is missing"
    if fault["type"] in ("model_type", "dict_type"):
        message = "expected a table"
    if fault["type"] in ("tuple_type", "list_type"):
        message = "expected a list, such as [1, 2]"
    entry = fault["input"]
    if any(isinstance(one, Mapping | BaseModel) for one in (entry if isinstance(entry, list) else [entry])):
        return f"'{key}': {message}" if key else message
    return f"'{key}' is {entry!r}: {message}"


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """The keys of the table at that place; indexes of lists do not change the table's kind."""
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            inner = [
                kind for kind in types_in(model.model_fields[part].annotation) if issubclass(kind, BaseModel)
            ]
            model = inner[0] if inner else model
    return list(model.model_fields)


def types_in(annotation: Any) -> Iterator[type]:
    """The classes that an annotation such as `list[Lamp] | None` is made of."""
    if isinstance(annotation, type):
        yield annotation
    for inner in getattr(annotation, "__args__", ()):
        yield from types_in(inner)
