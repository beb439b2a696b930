"""`gelgate new-part`: from a sensor and good pieces to a station that inspects, in one guided command.

Sensor and configuration, presses, fit, check, start. Each step leaves a file: the configuration, the folder of presses,
the bundle. A step whose file is there is not done again, so the same command goes on where it ended.
"""

import json
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Final, TypeVar

import typer

from calibration.acquisition.arguments import AcquireArguments
from calibration.acquisition.command import check_promise, fit_now, summarise, take_presses
from calibration.folders import write_whole
from edge import registry
from edge.cli.arguments import parse_values, plugin_options
from edge.cli.options import CONFIG, ConfigOption
from edge.config import Config, load_config, root_options
from edge.core.errors import ConfigError, DeviceNotFound, FitError, GelgateError
from edge.model.manifest_files import LONGEST_NAME

__all__ = ["new_part"]

T = TypeVar("T")

STATION: Final = """\
# A gelgate station, begun by `gelgate new-part`. `gelgate check --example` prints every table.
version = 1

[station]                     # the levels of every MQTT topic: gelgate/plant/line1/station1/gel/v1/...
site = "plant"
line = "line1"
station = "station1"

[device]
plugin = {plugin}
options = {options}

[inspection]
bundle_folder = "bundles"     # one bundle in it for each position of each part

[store]
path = "gelgate.db"

[[sinks]]
plugin = "page"
options = {{ port = {port} }}
"""

BROKER: Final = """
[[sinks]]
plugin = "mqtt"
options = {{ host = {host}, port = {port} }}
"""

PORTS: Final = range(1, 65536)

STEPS: Final = ("sensor", "presses", "fit", "check")

Part = Annotated[
    str, typer.Argument(metavar="PART[/POSITION]", help="What is pressed, such as bolt or bolt/pos1.")
]


def new_part(
    name: Part,
    config: ConfigOption = CONFIG,
    device: Annotated[
        str | None, typer.Option("--device", help="A device plugin, where several sensors are found.")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", help="A device option, as name=value; repeatable.")
    ] = None,
    promise: Annotated[float, typer.Option("--promise", help="The rate of false alarms to promise.")] = 0.1,
    is_quick: Annotated[
        bool, typer.Option("--yes", "-y", help="Answer every question with its default.")
    ] = False,
) -> None:
    """Guide from a sensor and good pieces to a running station.

    It finds the sensor, takes presses until they are enough, fits a bundle, checks the station and starts it. After
    an interruption the same command goes on."""
    from edge.cli.run import check, run
    from edge.gateway.preflight import try_sink

    guide = _Guide(is_quick)
    part, _, position = name.partition("/")
    bundle_name = _check_words(name, promise, device)
    with guide.step("sensor"):
        if not config.exists():
            _write_station(guide, config, *_find_sensor(guide, device, option or []))
        loaded = load_config(config)
        if device not in (None, loaded.device.plugin):
            raise ConfigError(
                f"{config} names the device plugin {loaded.device.plugin}, found --device {device}; leave it out, or "
                "name another file with --config"
            )
        typer.echo(f"{config} is the station, with the device plugin {loaded.device.plugin}")
        bundle = _bundle_path(loaded, config, bundle_name)
        for index, sink in enumerate(loaded.sinks):
            typer.echo(f"sink {sink.plugin}: {try_sink(sink, f'sinks.{index}')}")
    if bundle.exists():
        typer.echo(f"\n{bundle} is there already; remove it to press the part again")
    else:
        with guide.step("presses"):
            fit = _take_presses(guide, loaded, config, bundle, part, position, promise)
        with guide.step("fit"):
            fit()
    with guide.step("check"):
        check(config=config)
    spent = ", ".join(f"{step} {seconds:.0f} s" for step, seconds in guide.seconds.items())
    typer.echo(f"\n{name} is ready after {sum(guide.seconds.values()):.0f} s: {spent}")
    pages = [sink.options.get("port", 8080) for sink in loaded.sinks if sink.plugin == "page"]
    typer.echo("".join(f"its page while it runs: http://127.0.0.1:{port}/\n" for port in pages), nl=False)
    if guide.agrees("Start inspecting now (Ctrl-C ends it)?", is_default=True):
        run(config=config)
    else:
        typer.echo(f"start it with: gelgate run -c {config}")


def _check_words(name: str, promise: float, device: str | None) -> str:
    """Return the name of the bundle. Errors: ConfigError for a wrong word, before anything is begun."""
    check_promise("--promise", promise)
    if device is not None:
        registry.device(device)
    return _name_bundle(name)


@dataclass
class _Guide:
    """Asks, and takes the time of each step."""

    is_quick: bool
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, title: str) -> Iterator[None]:
        """Say which step begins, and where the same command goes on if it cannot be done."""
        started = time.monotonic()
        typer.echo(f"\n{STEPS.index(title) + 1} of {len(STEPS)}: {title}")
        try:
            yield
        except (GelgateError, OSError):
            typer.echo(f"not done: {title}; the same command goes on from here", err=True)
            raise
        self.seconds[title] = time.monotonic() - started

    def ask(self, question: str, default: str, read: Callable[[str], T]) -> T:
        """Return what is read of the answer, or of the default; ask again where reading is a ValueError. Errors:
        ConfigError where nobody can answer."""

        def take(answer: str) -> T:
            try:
                return read(answer.strip())
            except ValueError as error:
                raise typer.BadParameter(str(error)) from error

        if self.is_quick:
            return read(default)
        if not sys.stdin.isatty():
            raise ConfigError(
                f"'{question}' needs an answer and there is no terminal; add --yes for '{default}'"
            )
        answer: T = typer.prompt(question, default=default, value_proc=take)
        return answer

    def choose(self, question: str, most: int) -> int:
        """Return a number from 1, the default, to this. Errors: as `ask`."""

        def read(answer: str) -> int:
            if not (answer.isdecimal() and 1 <= int(answer) <= most):
                raise ValueError(f"'{answer}' is no answer, expected a number from 1 to {most}")
            return int(answer)

        return self.ask(question, "1", read)

    def agrees(self, question: str, *, is_default: bool) -> bool:
        """Return whether the answer begins with y. Errors: as `ask`."""

        def read(answer: str) -> bool:
            if not answer.lower().startswith(("y", "n")):
                raise ValueError(f"'{answer}' is no answer, expected y or n")
            return answer.lower().startswith("y")

        return self.ask(f"{question} (y/n)", "y" if is_default else "n", read)


def _take_presses(
    guide: _Guide, loaded: Config, config: Path, bundle: Path, part: str, position: str, promise: float
) -> Callable[[], None]:
    """Take presses until they are enough; return what fits them. Errors: FitError where they promise too little."""
    from edge.gateway.opening import played_recording
    from edge.recording.format import Recording

    played = played_recording(loaded.device)
    given = AcquireArguments(
        output=config.parent / "presses" / bundle.name,
        config=config,
        part=part,
        position=position or "default",
        profile=played.header.profile if isinstance(played, Recording) else "",
        per_piece=guide.choose("How often is each piece pressed before the next one?", 100),
        promise=promise,
    )
    typer.echo(
        "leave the gel free for some seconds, then press good pieces, each until it rests; Ctrl-C pauses, and the "
        "same command goes on"
    )
    acquiring, plan, limit = take_presses(given)
    summarise(acquiring, limit)
    standing = acquiring.standing
    if not standing.is_enough and not guide.agrees(
        "They are not enough. Fit them all the same?", is_default=standing.is_promised
    ):
        raise FitError(
            f"{standing.presses} presses of {part} do not keep the promise of at most {100 * promise:g} % false "
            "alarms; press more good pieces, or promise less with --promise"
        )
    return partial(fit_now, acquiring.folder.root, plan, standing, bundle)


def _find_sensor(
    guide: _Guide, device: str | None, option: Sequence[str]
) -> tuple[str, Mapping[str, object]]:
    """Return the plugin of the sensor that is plugged in, and its options. Errors: ConfigError, DeviceNotFound."""
    if option and device is None:
        raise ConfigError("--option belongs to one plugin; name it with --device")
    sensors, refused = [], []
    for name in [device] if device else registry.names("devices"):
        plugin = registry.device(name)
        if device is None and any(one.is_required() for one in plugin.Options.model_fields.values()):
            continue  # it plays a file, which nobody can find
        for candidate in plugin.discover(plugin_options("devices", name, plugin.Options, option)):
            if candidate.identity is None:
                refused.append(f"; {candidate.product} at {candidate.place} is refused: {candidate.refusal}")
            else:
                sensors.append((name, candidate.identity))
    if not sensors:
        raise DeviceNotFound(
            f"no sensor was found, expected one on USB{''.join(refused)}; plug it in, or name a plugin with --device"
        )
    for number, (name, identity) in enumerate(sensors, 1):
        typer.echo(f"  {number}  {name}: {identity.product}, serial {identity.serial}")
    name, identity = sensors[0 if len(sensors) == 1 else guide.choose("Which of these?", len(sensors)) - 1]
    model = registry.device(name).Options
    values = root_options(Path.cwd(), model, parse_values("--option", option))
    if len(sensors) > 1 and "serial" in model.model_fields:
        values["serial"] = identity.serial
    return name, values


def _write_station(guide: _Guide, config: Path, plugin: str, options: Mapping[str, object]) -> None:
    """Write a configuration with this sensor, the page, and a broker if one is named. Errors: ConfigError, OSError."""
    table = ", ".join(f"{key} = {_toml(value)}" for key, value in options.items())
    text = STATION.format(plugin=_toml(plugin), options=f"{{ {table} }}", port=_free_port())
    broker = guide.ask("MQTT broker, as host or host:port", "none", _read_broker)
    if broker is not None:
        text += BROKER.format(host=_toml(broker[0]), port=broker[1])
    write_whole(config, text.encode())


def _read_broker(answer: str) -> tuple[str, int] | None:
    """Return (host, port); None for none. Errors: ValueError."""
    if answer == "none":
        return None
    host, _, port = answer.partition(":")
    if (
        not re.fullmatch(r"[^\s/]+", host)
        or not re.fullmatch(r"[0-9]{0,5}", port)
        or int(port or 1883) not in PORTS
    ):
        raise ValueError(f"'{answer}' is no broker, expected host or host:port; such as 192.168.1.5:1883")
    try:
        socket.getaddrinfo(host, None)
    except (socket.gaierror, UnicodeError) as error:
        if getattr(error, "errno", None) != socket.EAI_AGAIN:  # the name server may be away
            raise ValueError(f"'{answer}' is no broker: the address '{host}' is not known") from error
    return host, int(port or 1883)


def _toml(value: object) -> str:
    """Write a text, number, boolean or a list of them. JSON is TOML for these, except for DEL."""
    return json.dumps(value, ensure_ascii=False, default=list).replace("\x7f", "\\u007f")


def _free_port() -> int:
    """Return the first port from 8080 on that nothing on this machine listens at."""
    for port in range(8080, 8180):
        with socket.socket() as tried:
            if tried.connect_ex(("127.0.0.1", port)) != 0:
                return port
    return 8080


def _name_bundle(part: str) -> str:
    """Name the folder of a part's bundle. Errors: ConfigError."""
    words = part.split("/", 1)
    name = "-".join(word for word in words if word)
    is_sound = words[0].strip() and max(map(len, words)) <= LONGEST_NAME and name.isprintable()
    if not is_sound or not name.strip(". ") or Path(name).name != name:
        raise ConfigError(
            f"{part[: 2 * LONGEST_NAME]!r} is no name of a part, expected a word such as bolt or bolt/pos1; "
            "give another"
        )
    return name


def _bundle_path(loaded: Config, config: Path, name: str) -> Path:
    """Return where the station looks for the bundle of this name. Errors: ConfigError."""
    table = loaded.inspection
    if table.bundle_folder is not None:
        return table.bundle_folder / name
    if table.bundle is not None and table.bundle.name == name:
        return table.bundle
    raise ConfigError(
        f'{config} names no bundle {name}; write bundle_folder = "bundles" in [inspection] in place of bundle or '
        "bundles, with the bundles of the other parts in that folder"
    )
