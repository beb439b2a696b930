"""`gelgate devices`: sensors, overview cameras, pedals and relays that are plugged in, and why one is refused."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from edge import registry
from edge.cli.arguments import plugin_options
from edge.clock import SystemClock
from edge.core.errors import ConfigError, GelgateError
from edge.core.plugins import RecordsDialogue, Resettable
from edge.core.printable import write_count

__all__ = ["devices"]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for a program.")]
DeviceName = Annotated[str | None, typer.Option("--device", help="Use this plugin only.")]
OptionTexts = Annotated[
    list[str] | None, typer.Option("--option", help="An option of that plugin, as name=value.")
]
Reset = Annotated[
    bool, typer.Option(help="Reset the sensor that --device and --option select, as a re-plug does.")
]
Dialogue = Annotated[
    Path | None,
    typer.Option(help="Keep what that sensor and its driver say to each other in this file, for a report."),
]


_KINDS: Final[dict[str, tuple[registry.PluginGroup, Callable[[str], Any]]]] = {
    "sensor": ("devices", registry.device),
    "overview": ("overviews", registry.overview),
    "trigger": ("triggers", registry.trigger),
    "actuator": ("actuators", registry.actuator),
}


def devices(
    as_json: AsJson = False,
    device: DeviceName = None,
    option: OptionTexts = None,
    reset: Reset = False,
    dialogue: Dialogue = None,
) -> None:
    """List the plugged-in cameras, pedals and relays.

    They are listed by plugin; a device that is refused with the reason. --device names the plugin of a sensor."""
    if (option or reset or dialogue) and device is None:
        raise ConfigError("--option, --reset and --dialogue belong to one plugin; name it with --device")
    plugins = [(kind, name) for kind, (group, _) in _KINDS.items() for name in registry.names(group)]
    if device is not None:
        sensor, plugins = registry.device(device), [("sensor", device)]
        if reset:
            if not isinstance(sensor, Resettable):
                raise ConfigError(f"the device plugin '{device}' has nothing to reset")
            options = plugin_options("devices", device, sensor.Options, option or [])
            typer.echo(f"reset {sensor.reset(options)}")
        if dialogue:
            if not isinstance(sensor, RecordsDialogue):
                raise ConfigError(
                    f"the device plugin '{device}' keeps no dialogue; use one on USB: gelsight_mini"
                )
            options = plugin_options("devices", device, sensor.Options, option or [])
            _write_dialogue(sensor.record_dialogue(options, SystemClock()), dialogue)
            return
    # A plugin that is a sensor and an overview camera is listed as a sensor.
    wanted = [(kind, name) for kind, name in plugins if kind != "overview" or ("sensor", name) not in plugins]
    reports = [_report(kind, name, option or []) for kind, name in wanted]
    if as_json:
        typer.echo(json.dumps(reports, indent=2, ensure_ascii=False))
    else:
        for report in reports:
            typer.echo(_as_text(report))


def _write_dialogue(lines: Sequence[str], path: Path) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    heard = json.loads(lines[0])["heard"]
    typer.echo(
        f"{path}: {write_count(len(lines) - 1, 'call')}, {write_count(len(heard['frames']), 'frame')} of "
        f"{heard['product']}; no picture can be seen in it, its serial number can"
    )
    if "fault" in heard:
        typer.echo(f"it ended with: {heard['fault']}")


def _report(kind: str, name: str, given: list[str]) -> dict[str, Any]:
    """Search with a plugin; say why where it cannot (a missing option, a missing package)."""
    group, find = _KINDS[kind]
    report: dict[str, Any] = {"plugin": name, "kind": kind, "seen": [], "note": ""}
    try:
        plugin = find(name)
        missing = [key for key, field in plugin.Options.model_fields.items() if field.is_required()]
        if missing and not given:
            if kind == "sensor":
                return {**report, "note": f"needs --option {missing[0]}=..."}
            why = f"needs options.{missing[0]}; `gelgate check` looks for the configured one"
            return {**report, "note": why}
        options = plugin_options(group, name, plugin.Options, given)
        seen = [asdict(device) for device in plugin.discover(options)]
        return {**report, "seen": seen, "note": "" if seen else "nothing found"}
    except GelgateError as error:
        if given:
            raise
        return {**report, "note": str(error)}


def _as_text(report: dict[str, Any]) -> str:
    kind = "" if report["kind"] == "sensor" else f" ({report['kind']})"
    lines = [f"{report['plugin']}{kind}:{' ' + report['note'] if report['note'] else ''}"]
    for device in report["seen"]:
        if device["refusal"] is None:
            lines.append(f"  found    {_description(device.get('identity') or device)}, {device['place']}")
        else:
            lines.append(f"  refused  {device['place']}: {device['refusal']}")
    return "\n".join(lines)


def _description(found: dict[str, Any]) -> str:
    """Product and serial, and of a camera its mode."""
    words = [found["product"]]
    if found["serial"]:
        words.append(f"serial {found['serial']}")
    if "mode" in found:
        rate = f" at nominal {found['nominal_fps']:g} fps" if found["nominal_fps"] else ""
        words.append(f"{found['mode'][0]}x{found['mode'][1]}{rate}")
    return ", ".join(words)
