"""Writes the pages of this folder that are printed from the program: `make docs`. Tests compare page and program.

`PAGES` lists them: some are printed wholly, as cli.md from the commands, of others tables between two marks, as that of
the states in contact.md.
"""

import ast
import inspect
import json
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from itertools import chain, pairwise
from pathlib import Path
from types import NoneType
from typing import Any, Final, get_args, get_origin, get_type_hints

import typer

from calibration.fitting.command import fit
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import EFFECTS
from calibration.simulator.scene import Scene
from calibration.training.train_config import TrainConfig
from edge import registry
from edge.cli import EXIT_MEANINGS, exit_code, place
from edge.config import Config
from edge.core import errors
from edge.core.contact.table import Signal, table_markdown
from edge.core.handshake import Code
from edge.core.heights.calibration import HeightCalibration
from edge.gateway.command_table import every_command
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.topic_reference import reference
from edge.model.manifest import Facts, Manifest
from plugins.handshakes import nodes, registers

FOLDER: Final = Path(__file__).parent
NOTICE: Final = "<!-- Printed from the program by `make docs`; change the program, not this page. -->\n"


# The command line


def cli_page() -> str:
    """Every verb with its arguments, options and defaults, and the exit codes."""
    every = {path: [one for one in parameters(verb) if not one.is_hidden] for path, verb in verbs()}
    shared = _shared(chain.from_iterable(every.values()))
    common = ["## Options of several verbs\n", _OPTION_HEADING, *(one.row() for one in shared), ""]
    sections = (_section(path, verb, every[path], shared) for path, verb in verbs())
    return "\n".join([NOTICE, "# Command line\n", *_exit_codes(), *common, *sections])


def _shared(every: Iterable["Parameter"]) -> list["Parameter"]:
    """Return the options that mean the same in at least three verbs, one of a name."""
    counts = Counter(one for one in every if not one.is_argument)
    found = {one.names[0]: one for one, count in reversed(counts.most_common()) if count >= 3}
    return [found[name] for name in sorted(found)]


def verbs() -> Iterator[tuple[str, Callable[..., None]]]:
    """Every command with its words, such as `gelgate gel show`."""
    for name in sorted(registry.names("commands"), key=place):
        verb = registry.command(name)
        if isinstance(verb, typer.Typer):
            for one in verb.registered_commands:
                if one.callback is not None:
                    yield (
                        f"gelgate {place(name)} {one.name or one.callback.__name__.replace('_', '-')}",
                        one.callback,
                    )
        else:
            yield f"gelgate {place(name)}", verb


def _exit_codes() -> Iterator[str]:
    yield "A reference. Refusals are one sentence on the standard error output; results go to the standard output.\n"
    yield "| exit code | meaning |\n| --- | --- |"
    yield from (f"| {code} | {meaning} |" for code, meaning in EXIT_MEANINGS.items())
    yield "\n[errors.md](errors.md) says which error gives which code.\n"


@dataclass(frozen=True)
class Parameter:
    """One argument or option of a verb, from its signature."""

    names: tuple[str, ...]
    value: str
    default: str
    help: str
    is_argument: bool
    is_hidden: bool = False

    @classmethod
    def of(cls, name: str, annotation: Any, default: Any) -> "Parameter":
        kind, info = get_args(annotation)[:2]
        is_argument = isinstance(info, typer.models.ArgumentInfo)
        is_flag = kind is bool
        # Inside Annotated, typer takes the first declared name for a default.
        declared = (*([info.default] if isinstance(info.default, str) else []), *(info.param_decls or ()))
        dashed = name.replace("_", "-")
        names = declared or (f"--{dashed}", *([f"--no-{dashed}"] if is_flag else []))
        if is_argument:
            names = (info.metavar or name.upper(),)
        value = "" if is_flag or is_argument else info.metavar or _type_words(kind, info)
        return cls(names, value, _default(default), info.help or "", is_argument, info.hidden)

    def row(self) -> str:
        names = ", ".join(f"`{name}`" for name in self.names)
        return _row(f"{names} {self.value}", self.default, self.help)


def parameters(verb: Callable[..., None]) -> list[Parameter]:
    """What a verb takes, arguments first."""
    hints = get_type_hints(verb, include_extras=True)
    found = [
        Parameter.of(name, hints[name], one.default)
        for name, one in inspect.signature(verb).parameters.items()
    ]
    return sorted(found, key=lambda one: not one.is_argument)


_OPTION_HEADING: Final = "| option | default | what it is |\n| --- | --- | --- |"


def _section(
    path: str, verb: Callable[..., None], taken: Sequence[Parameter], shared: Sequence[Parameter]
) -> str:
    words = [path, *(one.names[0] for one in taken if one.is_argument)]
    lines = [f"## {' '.join(words)}\n\n{_paragraphs(inspect.getdoc(verb))}\n"]
    if own := [one for one in taken if one not in shared]:
        lines += [_OPTION_HEADING, *(one.row() for one in own), ""]
    if others := [f"`{one.names[0]}`" for one in taken if one in shared]:
        lines.append(f"Also {', '.join(others)}, as [above](#options-of-several-verbs).\n")
    return "\n".join(lines)


def _type_words(kind: Any, info: Any) -> str:
    """What may follow an option, in words."""
    kinds = {one for one in (kind, *get_args(kind)) if isinstance(one, type)} - {NoneType}
    inner = {one for given in get_args(kind) for one in get_args(given)} | kinds
    words = next(word for one, word in _WORDS.items() if one in inner)
    limits = (("at least", info.min), ("at most", info.max))
    bounds = [f"{word} {_number(limit)}" for word, limit in limits if limit is not None]
    is_list = list in {get_origin(one) for one in (kind, *get_args(kind))}
    return ", ".join([words, *bounds, *(["repeatable"] if is_list else [])])


_WORDS: Final = {Path: "path", int: "whole number", float: "number", str: "text"}


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty:
        return "required"
    if isinstance(value, bool):
        return "on" if value else "off"
    return "" if value in (None, "") else f"`{value}`"


# The configuration


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
    yield "## The complete file\n"
    yield from _table(schema, schema["$defs"], skip=_tables(schema))
    for name, model in _tables(schema).items():
        inner = schema["$defs"][model]
        yield f"## [{name}]\n\n{_paragraphs(inner['description'])}\n"
        yield from _table(inner, schema["$defs"])
        for field, value in inner["properties"].items():
            for listed in _table_options(value.get("items", {}), schema["$defs"]):
                yield f"### [[{name}.{field}]]\n\n{_paragraphs(listed['description'])}\n"
                yield from _table(listed, schema["$defs"])
    yield "## [device] and [[sinks]]\n\nOne plugin each, with its own options below. Sinks have `name`.\n"
    yield from _table(schema["$defs"]["SinkTable"], schema["$defs"])
    for heading, model in _OWN_TABLES.items():
        inner = schema["$defs"][model]
        yield f"## {heading}\n\n{_paragraphs(inner['description'])}\n"
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
        yield f"## {key}: {name}\n\n{_paragraphs(schema['description'])}\n"
        if schema["properties"]:
            yield from _table(schema, schema.get("$defs", {}))
        for field, value in schema["properties"].items():
            for inner in _table_options(value, schema.get("$defs", {})):
                yield f"`{field}` is a table. {inner['description']}\n"
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
    yield "| key | value | default | what it is |\n| --- | --- | --- | --- |"
    for name, field in schema["properties"].items():
        if name not in (skip or {}):
            default = "required" if name in schema.get("required", ()) else _written(field.get("default"))
            yield f"| `{prefix}{name}` | {_value(field)} | {default} | {_cell(field['description'])} |"
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
    said = [f"{word} {_number(field[key])}" for key, word in bounds.items() if key in field]
    if "pattern" in field:
        said.append("matching `" + field["pattern"].replace("|", "\\|") + "`")
    return ", " + ", ".join(said) if said else ""


def _number(value: float) -> str:
    return f"{value:,.0f}" if value == round(value) else f"{value:g}"


def _written(value: object) -> str:
    """A value as TOML writes it."""
    if value is None or value in ({}, []):
        return ""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else value
    return f'`"{text}"`' if isinstance(value, str) else f"`{text}`"


# The detectors' parameters


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
    yield "## fit\n\n| name | value | default | what it is |\n| --- | --- | --- | --- |"
    for one in parameters(fit):
        if one.is_hidden:
            name = one.names[0].removeprefix("--")
            yield _row(f"`{name}`", one.value or "`true` or `false`", one.default, one.help)
    yield ""


def _detectors() -> Iterator[str]:
    heading = "| name | value | corrected | paper | what it is |\n| --- | --- | --- | --- | --- |"
    tables = {name: dict(_parameter_rows(name)) for name in registry.names("detectors")}
    counts = Counter(chain.from_iterable(table.items() for table in tables.values()))
    shared = dict(item for item, count in counts.items() if count >= 3)
    yield "\n".join(["## Of several detectors\n", heading, *shared.values(), ""])
    for name, table in tables.items():
        own = [row for row in table.values() if row not in shared.values()]
        yield "\n".join([f"## {name}\n", heading, *own, ""])
        if others := [f"`{field}`" for field, row in table.items() if row in shared.values()]:
            yield f"Also {', '.join(others)}, as [above](#of-several-detectors).\n"


def _parameter_rows(detector: str) -> Iterator[tuple[str, str]]:
    """Every parameter of a detector and its row, with the defaults of both modes."""
    corrected, paper = (registry.detector(detector).parameters(mode) for mode in ("corrected", "paper"))
    for field, about in paper.model_json_schema()["properties"].items():
        ours = f"`{_json(getattr(corrected, field))}`" if field in type(corrected).model_fields else ""
        null = " or `null`" if {"type": "null"} in about.get("anyOf", ()) else ""
        value, default = _value(about) + null, f"`{_json(getattr(paper, field))}`"
        if field != "mode":
            yield field, _row(f"`{field}`", value, ours, default, about["description"])


def _json(value: object) -> str:
    """A value as `--set` takes it; a text needs no quotes."""
    return (
        value
        if isinstance(value, str)
        else json.dumps(round(value, 4) if isinstance(value, float) else value)
    )


# Errors


def errors_page() -> str:
    """Every error: what it means, whose fault it is, what comes next, and the exit code."""
    return "\n".join([NOTICE, *_errors()])


_ABOUT_ERRORS: Final = """\
# Errors

A reference. Each error is one sentence with the thing, what was found, what was expected and what to do. Before the
start it ends the command with the exit code given here. While the gateway runs, what the sensor, the broker or the disk
does is announced (`state`, `alarm`), counted, and tried again.

| error | what it means | whose fault | what comes next | exit code |
| --- | --- | --- | --- | --- |"""


def _errors() -> Iterator[str]:
    yield _ABOUT_ERRORS
    for kind, whose, following in tree():
        mark = "" if errors.GelgateError in kind.__bases__ else "· "
        meaning = (kind.__doc__ or "").partition("\n")[0]
        yield _row(f"{mark}`{kind.__name__}`", meaning, whose, following, str(exit_code(kind)))
    yield ""


def tree() -> Iterator[tuple[type[errors.GelgateError], str, str]]:
    """(error, whose fault, what comes next) in the order of the tree at the top of edge/core/errors.py."""
    for name, whose, following in re.findall(r"[├└]── (\w+) +(\w+) · (.*)", errors.__doc__ or ""):
        yield getattr(errors, name), whose, _cell(following)


# The registers of a PLC


def heights_page() -> str:
    """Print the page again with what a calibration file holds."""
    rows = (_row(f"`{name}`", text) for name, text in _explained(HeightCalibration))
    heading = "| key of the file | meaning |\n| --- | --- |"
    return _print_tables("heights.md", {"edge/core/heights/calibration.py": ("", heading, *rows, "")})


def operations_page() -> str:
    """Print the page again with every alarm, as the page at the station says it."""
    rows = (_row(f"`{name}`", kind.title, _link(kind.what_to_do)) for name, kind in ALARMS.items())
    heading = "| alarm | what has happened | what to do |\n| --- | --- | --- |"
    return _print_tables("operations.md", {"edge/messaging/alarm_payload.py": ("", heading, *rows, "")})


def _link(text: str) -> str:
    """Return what is to be done with its links, which the page at the station has not."""
    text = text.replace("see Gel change", "see [Gel change](#gel-change)")
    return re.sub(r"see (\w+\.md)", r"see [\1](\1)", text)


def plc_page() -> str:
    """Print the page again, with the tables of its map."""
    return _print_tables(
        "plc.md",
        {
            "plugins/handshakes/registers.py": _registers(),
            "plugins/handshakes/nodes.py": _opcua_nodes(),
        },
    )


def backbone_page() -> str:
    """Print the page again with the settings of a training run, as the run that ships has them."""
    values = TrainConfig.shipped()
    fields = sorted(TrainConfig.model_fields.items())
    rows = (_row(name, str(getattr(values, name)), field.description) for name, field in fields)
    heading = "| setting | value | meaning |\n| --- | --- | --- |"
    return _print_tables("backbone.md", {"calibration/training/train_config.py": ("", heading, *rows, "")})


def bundle_page() -> str:
    """Print the page again with every field of the manifest, and what is written under it."""
    rows = (_row(f"`{name}`", text) for name, text in chain(_explained(Facts), _explained(Manifest)))
    heading = "| field | meaning |\n| --- | --- |"
    return _print_tables("bundle.md", {"edge/model/manifest.py": ("", heading, *rows, "")})


def _explained(kind: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of one class, each with the text under it, where `docs/page.md#section` becomes a link."""
    body = ast.parse(inspect.getsource(kind)).body[0].body  # type: ignore[attr-defined]
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign | ast.Assign) and isinstance(text, ast.Expr):
            name = field.target if isinstance(field, ast.AnnAssign) else field.targets[0]
            linked = re.sub(r"docs/([\w-]+\.md)([#\w-]*)", r"[\1](\1\2)", ast.literal_eval(text.value))
            yield ast.unparse(name), linked


def contact_page() -> str:
    """Print the page again with the states and signals of the program."""
    signals = (_row(name.lower(), text) for name, text in _explained(Signal))
    heading = "| signal | meaning |\n| --- | --- |"
    lines = ("", *table_markdown().splitlines(), "", heading, *signals, "")
    return _print_tables("contact.md", {"edge/core/contact/table.py": lines})


def simulator_page() -> str:
    """Print the page again with the keys of a scene, and what each defect and effect of the simulator is."""
    keys = (_row(f"`{name}`", text) for name, text in _explained(Scene))
    return _print_tables(
        "simulator.md",
        {
            "calibration/simulator/scene.py": ("", "| key | meaning |\n| --- | --- |", *keys, ""),
            "calibration/simulator/defects.py": _functions("defect, at severity 1", DEFECTS),
            "calibration/simulator/effects.py": _functions("effect", EFFECTS),
        },
    )


def _functions(heading: str, functions: Mapping[str, Callable[..., object]]) -> Iterator[str]:
    yield f"\n| {heading} | what it is |\n| --- | --- |"
    yield from (
        _row(name, (inspect.getdoc(function) or "").partition("\n\n")[0])
        for name, function in functions.items()
    )
    yield ""


def _print_tables(name: str, tables: Mapping[str, Iterable[str]]) -> str:
    """Return a page as it is, with the lines between its marks printed again. tables: by what they are printed from."""
    page, end = (FOLDER / name).read_text(encoding="utf-8"), "<!-- end -->\n"
    for source, lines in tables.items():
        start = f"<!-- printed from {source} -->\n"
        before, _, rest = page.partition(start)
        page = before + start + "\n".join(lines) + "\n" + end + rest.partition(end)[2]
    return page


def _registers() -> Iterator[str]:
    heading = "| address | name | meaning |\n| --- | --- | --- |"
    yield f"\n**Coils** (functions 1, 5, 15), which the PLC writes:\n\n{heading}"
    yield from (_row(str(n), name, about) for n, (name, about) in enumerate(registers.COILS))
    yield f"\n**Discrete inputs** (function 2):\n\n{heading}"
    yield from (_row(str(n), name, about) for n, (name, about, _) in enumerate(registers.STATUS_BITS))
    yield f"\n**Input registers** (function 4):\n\n{heading}"
    yield from _places((one.name, one.count, one.meaning) for one in registers.INPUTS)
    yield "\n**Holding registers** (functions 3, 6, 16), which the PLC writes; a trigger takes them as they are then:"
    yield f"\n{heading}"
    yield from _places((name, count, about) for name, (count, about) in registers.HOLDING.items())
    yield "\n**Codes** of an error and of a refusal:\n\n| code | meaning |\n| --- | --- |"
    yield from (_row(str(int(code)), code.meaning) for code in Code)
    yield "\n**Alarm word**; [operations.md](operations.md#alarms) has every alarm:\n\n| bit | alarms |\n| --- | --- |"
    alarms = [", ".join(f"`{one}`" for one in names) for names in registers.ALARM_BITS]
    yield from (_row(str(bit), names) for bit, names in enumerate([*alarms, "every other one"]))
    yield ""


def _opcua_nodes() -> Iterator[str]:
    yield "\n| variable | type | meaning |\n| --- | --- | --- |"
    yield from (_row(f"`{path}`", kind, about) for path, (kind, about, _) in nodes.VARIABLES.items())
    yield "\n| method | arguments | meaning |\n| --- | --- | --- |"
    for path, (given, about) in nodes.METHODS.items():
        yield _row(f"`{path}`", ", ".join(f"{name} ({kind})" for name, kind in given.items()), about)
    yield "\n| code of a refusal | status of the method |\n| --- | --- |"
    yield from (_row(str(int(code)), status) for code, status in nodes.STATUS.items())
    yield ""


def _places(rows: Iterable[tuple[str, int, str]]) -> Iterator[str]:
    start = 0
    for name, count, about in rows:
        yield _row(str(start) if count == 1 else f"{start} to {start + count - 1}", name, about)
        start += count


# What a press takes on the processors of which somebody sent the figures


def processors_page() -> str:
    """Print the page again with a row for each file of the folder `processors`, the fastest first."""
    runs = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted((FOLDER / "processors").glob("*.json"))
    ]
    runs.sort(key=lambda run: run["stages"]["outbox"]["median"])
    heading = (_row(*_PROCESSOR_COLUMNS), _row(*("---" for _ in _PROCESSOR_COLUMNS)))
    return _print_tables("processors.md", {"docs/processors": ("", *heading, *map(_processor, runs), "")})


_PROCESSOR_COLUMNS: Final = (
    "processor, cores",
    "system",
    "gelgate, onnxruntime",
    "bundle",
    "outbox, median / p99 ms",
    "of its floor",
    "a press, ms of processor",
    "memory, MB",
    "load",
)


def _processor(run: Mapping[str, Any]) -> str:
    machine, outbox, pressing = run["machine"], run["stages"]["outbox"], run["pressing"] or {}
    press, memory = pressing.get("press_cpu_ms"), pressing.get("memory_bytes")
    return _row(
        f"{machine['processor']}, {machine['cores']}",
        f"{machine['system']}, Python {machine['python']}",
        f"{machine['libraries']['gelgate']}, {machine['libraries']['onnxruntime']}",
        run["bundle"],
        f"{outbox['median']:.1f} / {outbox['p99']:.1f}",
        f"{outbox['ratio']:.2f}",
        "" if press is None else f"{press:.0f}",
        "" if memory is None else f"{memory / 1e6:.0f}",
        f"{machine['load_at_start']:g}",
    )


# Writing


def _paragraphs(text: str | None) -> str:
    """A docstring as Markdown: lines that belong together joined."""
    return "\n\n".join(" ".join(part.split()) for part in (text or "").split("\n\n"))


def _row(*cells: str | None) -> str:
    return "| " + " | ".join(_cell(cell) for cell in cells) + " |"


def _cell(text: str | None) -> str:
    return " ".join((text or "").replace("|", "\\|").split())


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "backbone.md": backbone_page,
    "bundle.md": bundle_page,
    "cli.md": cli_page,
    "config.md": config_page,
    "contact.md": contact_page,
    "errors.md": errors_page,
    "operations.md": operations_page,
    "parameters.md": parameters_page,
    "heights.md": heights_page,
    "mqtt.md": lambda: reference(every_command()),
    "plc.md": plc_page,
    "processors.md": processors_page,
    "simulator.md": simulator_page,
}


def find_missing() -> list[str]:
    """Return the entry points of pyproject.toml that are not installed: the pages would leave them out."""
    project = tomllib.loads((FOLDER.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = {(point.group, point.name) for point in distribution("gelgate").entry_points}
    points = ((group, name) for group, names in project["entry-points"].items() for name in names)
    return [f"{group}: {name}" for group, name in points if (group, name) not in installed]


if __name__ == "__main__":
    if missing := find_missing():
        sys.exit(
            f"not installed yet: {', '.join(missing)}; run `pip install -e . --no-deps`, then print again"
        )
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding="utf-8")
        print(f"docs/{name}")
