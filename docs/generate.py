"""Writes the pages of this folder that are printed from the program: `make docs`. Tests compare page and program.

`PAGES` lists them: some are printed wholly, as cli.md from the commands, of others tables between two marks, as that of
the states in contact.md.
"""

import inspect
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import distribution
from typing import Any, Final

from printed_cli import cli_page
from printed_rows import FOLDER, NOTICE, cell, explain, print_again, table
from printed_settings import config_page, parameters_page

from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import EFFECTS
from calibration.simulator.scene import Scene
from calibration.training.train_config import TrainConfig
from edge.cli import exit_code
from edge.core import errors
from edge.core.contact.table import Signal, table_markdown
from edge.core.handshake import Code
from edge.core.heights.calibration import HeightCalibration
from edge.gateway.command_table import every_command
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.topic_reference import reference
from edge.model.manifest import Facts, Manifest
from plugins.handshakes import nodes, registers

_ABOUT_ERRORS: Final = """\
# Errors

A reference. Each error is one sentence with the thing, what was found, what was expected and what to do. Before the
start it ends the command with the exit code given here. While the gateway runs, what the sensor, the broker or the disk
does is announced (`state`, `alarm`), counted, and tried again."""


def errors_page() -> str:
    """Every error: what it means, whose fault it is, what comes next, and the exit code."""
    rows = (
        (
            f"{'' if errors.GelgateError in kind.__bases__ else '· '}`{kind.__name__}`",
            (kind.__doc__ or "").partition("\n")[0],
            *why,
            str(exit_code(kind)),
        )
        for kind, *why in tree()
    )
    heading = ("error", "what it means", "whose fault", "what comes next", "exit code")
    return "\n".join([NOTICE, _ABOUT_ERRORS, *table(heading, rows), ""])


def tree() -> Iterator[tuple[type[errors.GelgateError], str, str]]:
    """(error, whose fault, what comes next) in the order of the tree at the top of edge/core/errors.py."""
    for name, whose, following in re.findall(r"[├└]── (\w+) +(\w+) · (.*)", errors.__doc__ or ""):
        yield getattr(errors, name), whose, cell(following)


def heights_page() -> str:
    """Print the page again with what a calibration file holds."""
    rows = table(("key of the file", "meaning"), explain(HeightCalibration))
    return print_again("heights.md", {"edge/core/heights/calibration.py": rows})


def operations_page() -> str:
    """Print the page again with every alarm, as the page at the station says it."""
    alarms = ((f"`{name}`", kind.title, _link(kind.what_to_do)) for name, kind in ALARMS.items())
    rows = table(("alarm", "what has happened", "what to do"), alarms)
    return print_again("operations.md", {"edge/messaging/alarm_payload.py": rows})


def _link(text: str) -> str:
    """Return what is to be done with its links, which the page at the station has not."""
    text = text.replace("see Gel change", "see [Gel change](#gel-change)")
    return re.sub(r"see (\w+\.md)", r"see [\1](\1)", text)


def backbone_page() -> str:
    """Print the page again with the settings of a training run, as the run that ships has them."""
    values = TrainConfig.shipped()
    fields = sorted(TrainConfig.model_fields.items())
    rows = ((name, str(getattr(values, name)), field.description) for name, field in fields)
    settings = table(("setting", "value", "meaning"), rows)
    return print_again("backbone.md", {"calibration/training/train_config.py": settings})


def bundle_page() -> str:
    """Print the page again with every field of the manifest, and what is written under it."""
    fields = table(("field", "meaning"), [*explain(Facts), *explain(Manifest)])
    return print_again("bundle.md", {"edge/model/manifest.py": fields})


def contact_page() -> str:
    """Print the page again with the states and signals of the program."""
    signals = ((name.strip("`").lower(), text) for name, text in explain(Signal))
    lines = ["", *table_markdown().splitlines(), *table(("signal", "meaning"), signals)]
    return print_again("contact.md", {"edge/core/contact/table.py": lines})


def simulator_page() -> str:
    """Print the page again with the keys of a scene, and what each defect and effect of the simulator is."""
    return print_again(
        "simulator.md",
        {
            "calibration/simulator/scene.py": table(("key", "meaning"), explain(Scene)),
            "calibration/simulator/defects.py": _functions("defect, at severity 1", DEFECTS),
            "calibration/simulator/effects.py": _functions("effect", EFFECTS),
        },
    )


def _functions(heading: str, functions: Mapping[str, Callable[..., object]]) -> Iterator[str]:
    said = {name: inspect.getdoc(function) or "" for name, function in functions.items()}
    return table((heading, "what it is"), ((name, text.partition("\n\n")[0]) for name, text in said.items()))


def plc_page() -> str:
    """Print the page again, with the tables of its map."""
    tables = {"plugins/handshakes/registers.py": _registers(), "plugins/handshakes/nodes.py": _opcua_nodes()}
    return print_again("plc.md", tables)


def _registers() -> Iterator[str]:
    heading = ("address", "name", "meaning")
    yield "\n**Coils** (functions 1, 5, 15), which the PLC writes:"
    yield from table(heading, ((str(n), name, about) for n, (name, about) in enumerate(registers.COILS)))
    yield "\n**Discrete inputs** (function 2):"
    bits = enumerate(registers.STATUS_BITS)
    yield from table(heading, ((str(n), name, about) for n, (name, about, _) in bits))
    yield "\n**Input registers** (function 4):"
    yield from table(
        heading, _places((register.name, register.count, register.meaning) for register in registers.INPUTS)
    )
    yield "\n**Holding registers** (functions 3, 6, 16), which the PLC writes; a trigger takes them as they are then:"
    held = registers.HOLDING.items()
    yield from table(heading, _places((name, count, about) for name, (count, about) in held))
    yield "\n**Codes** of an error and of a refusal:"
    yield from table(("code", "meaning"), ((str(int(code)), code.meaning) for code in Code))
    yield "\n**Alarm word**; [operations.md](operations.md#alarms) has every alarm:"
    alarms = [
        *(", ".join(f"`{verb}`" for verb in names) for names in registers.ALARM_BITS),
        "every other one",
    ]
    yield from table(("bit", "alarms"), ((str(bit), names) for bit, names in enumerate(alarms)))


def _opcua_nodes() -> Iterator[str]:
    variables = ((f"`{path}`", kind, about) for path, (kind, about, _) in nodes.VARIABLES.items())
    yield from table(("variable", "type", "meaning"), variables)
    methods = (
        (f"`{path}`", ", ".join(f"{name} ({kind})" for name, kind in given.items()), about)
        for path, (given, about) in nodes.METHODS.items()
    )
    yield from table(("method", "arguments", "meaning"), methods)
    statuses = ((str(int(code)), status) for code, status in nodes.STATUS.items())
    yield from table(("code of a refusal", "status of the method"), statuses)


def _places(rows: Iterable[tuple[str, int, str]]) -> Iterator[tuple[str, str, str]]:
    start = 0
    for name, count, about in rows:
        yield str(start) if count == 1 else f"{start} to {start + count - 1}", name, about
        start += count


def performance_page() -> str:
    """Print the page again with a row for each file of the folder `processors`, the fastest first."""
    files = sorted((FOLDER / "processors").glob("*.json"))
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in files]
    runs.sort(key=lambda run: run["stages"]["outbox"]["median"])
    rows = table(_PROCESSOR_COLUMNS, map(_describe_run, runs))
    return print_again("performance.md", {"docs/processors": rows})


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


def _describe_run(run: Mapping[str, Any]) -> Sequence[str]:
    machine, outbox, pressing = run["machine"], run["stages"]["outbox"], run["pressing"] or {}
    press, memory = pressing.get("press_cpu_ms"), pressing.get("memory_bytes")
    return (
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


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "backbone.md": backbone_page,
    "bundle.md": bundle_page,
    "cli.md": cli_page,
    "config.md": config_page,
    "contact.md": contact_page,
    "errors.md": errors_page,
    "operations.md": operations_page,
    "performance.md": performance_page,
    "parameters.md": parameters_page,
    "heights.md": heights_page,
    "mqtt.md": lambda: reference(every_command()),
    "plc.md": plc_page,
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
