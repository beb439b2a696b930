"""Prints docs/config.md and docs/parameters.md: the keys of a station, and what a fit and each detector takes."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, Final

from printed_cli import parameters
from printed_rows import NOTICE, number, paragraphs, table

from calibration.fitting.command import fit
from edge import registry
from edge.config import Config


def config_page() -> str:
    """Every key of the configuration, and every option of every plugin that comes with the product."""
    return "\n".join([NOTICE, *_config(), *chain.from_iterable(map(_plugins, _PLUGIN_TABLES))])


# The groups with a table in the configuration, and the key of that table.
_PLUGIN_TABLES: Final[dict[registry.PluginGroup, str]] = {
    "devices": "device",
    "overviews": "overview",
    "sinks": "sinks",
    "triggers": "triggers",
    "actuators": "actuators",
    "handshakes": "handshake",
}


def _config() -> Iterator[str]:
    yield (
        "# Configuration\n\n"
        "A reference. One TOML file describes a station. It is read at the start, and the bundles in its\n"
        "`[inspection]` again at a reload; every fault is in one report (`gelgate check`). Relative paths, those in\n"
        "plugin options too, are taken from the file's own folder. `gelgate check --example` prints\n"
        "[one with every table](../edge/service/example.toml).\n"
    )
    schema = Config.model_json_schema()
    yield "## The complete file"
    yield from _table(schema, schema["$defs"], skip=_tables(schema))
    for name, model in _tables(schema).items():
        inner = schema["$defs"][model]
        yield f"## [{name}]\n\n{paragraphs(inner['description'])}"
        yield from _table(inner, schema["$defs"])
        for field, value in inner["properties"].items():
            for listed in _table_options(value.get("items", {}), schema["$defs"]):
                yield f"### [[{name}.{field}]]\n\n{paragraphs(listed['description'])}"
                yield from _table(listed, schema["$defs"])
    yield "## [device] and [[sinks]]\n\nOne plugin each, with its own options below. Sinks have `name`."
    yield from _table(schema["$defs"]["SinkTable"], schema["$defs"])
    for heading, model in _OWN_TABLES.items():
        inner = schema["$defs"][model]
        yield f"## {heading}\n\n{paragraphs(inner['description'])}"
        yield from _table(inner, schema["$defs"])


_OWN_TABLES: Final = {
    "[overview]": "OverviewTable",
    "[piece]": "PieceTable",
    "[[piece.places]]": "PlaceTable",
    "[[triggers]]": "TriggerTable",
    "[[actuators]]": "ActuatorTable",
    "[[actuators.outputs]]": "OutputTable",
    "[handshake]": "HandshakeTable",
}


def _tables(schema: Mapping[str, Any]) -> dict[str, str]:
    """Keys that are tables of their own, with the definition that describes each."""
    return {
        name: field["$ref"].rpartition("/")[2]
        for name, field in schema["properties"].items()
        if "$ref" in field and not field["$ref"].endswith("/PluginTable")
    }


def _plugins(kind: registry.PluginGroup) -> Iterator[str]:
    key = _PLUGIN_TABLES[kind]
    for name in registry.names(kind):
        options = registry.options(kind, name)
        schema = options.model_json_schema()
        yield f"## {key}: {name}\n\n{paragraphs(schema['description'])}"
        yield from _table(schema, schema.get("$defs", {})) if schema["properties"] else [""]
        for field, value in schema["properties"].items():
            for inner in _table_options(value, schema.get("$defs", {})):
                yield f"`{field}` is a table. {inner['description']}"
                yield from _table(inner, schema["$defs"], prefix=f"{field}.")


def _table_options(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    for choice in (field, *field.get("anyOf", ())):
        if "$ref" in choice:
            yield definitions[choice["$ref"].rpartition("/")[2]]


def _table(
    schema: Mapping[str, Any],
    definitions: Mapping[str, Any],
    prefix: str = "",
    skip: Mapping[str, str] | None = None,
) -> Iterator[str]:
    rows = (
        (
            f"`{prefix}{name}`",
            _value(field),
            "required" if name in schema.get("required", ()) else _written(field.get("default")),
            field["description"],
        )
        for name, field in schema["properties"].items()
        if name not in (skip or {})
    )
    yield from table(("key", "value", "default", "what it is"), rows)
    yield ""


def _value(field: Mapping[str, Any]) -> str:
    """What may stand there, in words."""
    if "anyOf" in field:
        return " or ".join(_value(choice) for choice in field["anyOf"] if choice.get("type") != "null")
    if "enum" in field:
        return " or ".join(_written(value) for value in field["enum"])
    if "const" in field:
        return _written(field["const"])
    if field.get("format") == "path":
        return "path"
    if field.get("type") == "array":
        item = field.get("items") or field["prefixItems"][0]
        inner = "string" if item.get("$ref", "").endswith("/Fault") else item.get("type")
        words = {"string": "texts", "integer": "whole numbers", "number": "numbers"}
        return "list of " + words.get(inner, "tables")
    names = {
        "integer": "whole number",
        "number": "number",
        "string": "text",
        "boolean": "true or false",
        "object": "table",
    }
    return names[field.get("type", "object")] + _range(field)


def _range(field: Mapping[str, Any]) -> str:
    bounds = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    said = [f"{word} {number(field[key])}" for key, word in bounds.items() if key in field]
    if "pattern" in field:
        said.append("matching `" + field["pattern"] + "`")
    return ", " + ", ".join(said) if said else ""


def _written(value: object) -> str:
    """A value as TOML writes it."""
    if value is None or value in ({}, []):
        return ""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else value
    return f'`"{text}"`' if isinstance(value, str) else f"`{text}`"


_ABOUT_PARAMETERS: Final = """\
# Parameters of a fit and of the detectors

A reference. `gelgate fit --method METHOD --set NAME=VALUE` sets one; a value is written as JSON (`--set rank=8`, `--set
dims=[31]`, `--set window_mm=null`). The first table is of every fit. In the others the two columns in the middle are
the defaults of `--set mode=corrected` and `--set mode=paper`. Where the first is empty the switch re-creates a
published defect: it is off unless named. [detectors.md](detectors.md) explains the methods, and what their settings
were measured at.
"""


def parameters_page() -> str:
    """Every parameter of every detector, with the defaults of both modes."""
    return "\n".join([NOTICE, _ABOUT_PARAMETERS, *_fit(), *_detectors()])


def _fit() -> Iterator[str]:
    hidden = (parameter for parameter in parameters(fit) if parameter.is_hidden)
    yield "## fit"
    yield from table(
        ("name", "value", "default", "what it is"),
        (
            (f"`{one.names[0].removeprefix('--')}`", one.value or "`true` or `false`", one.default, one.help)
            for one in hidden
        ),
    )
    yield ""


def _detectors() -> Iterator[str]:
    heading = ("name", "value", "corrected", "paper", "what it is")
    every = {name: dict(_parameter_rows(name)) for name in registry.names("detectors")}
    counts = Counter(chain.from_iterable(rows.items() for rows in every.values()))
    shared = dict(item for item, count in counts.items() if count >= 3)
    yield "\n".join(["## Of several detectors", *table(heading, shared.values()), ""])
    for name, rows in every.items():
        own = [cells for cells in rows.values() if cells not in shared.values()]
        yield "\n".join([f"## {name}", *table(heading, own), ""])
        if others := [f"`{field}`" for field, cells in rows.items() if cells in shared.values()]:
            yield f"Also {', '.join(others)}, as [above](#of-several-detectors).\n"


def _parameter_rows(detector: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every parameter of a detector and its row, with the defaults of both modes."""
    corrected, paper = (registry.detector(detector).parameters(mode) for mode in ("corrected", "paper"))
    for field, about in paper.model_json_schema()["properties"].items():
        ours = f"`{_json(getattr(corrected, field))}`" if field in type(corrected).model_fields else ""
        null = " or `null`" if {"type": "null"} in about.get("anyOf", ()) else ""
        value, default = _value(about) + null, f"`{_json(getattr(paper, field))}`"
        if field != "mode":
            yield field, (f"`{field}`", value, ours, default, about["description"])


def _json(value: object) -> str:
    """A value as `--set` takes it; a text needs no quotes."""
    return (
        value
        if isinstance(value, str)
        else json.dumps(round(value, 4) if isinstance(value, float) else value)
    )
