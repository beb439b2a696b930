"""`gelgate devices`: sensors, overview cameras, pedals and relays that are plugged in, and why one is refused."""

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any, Final

import typer

from edge import registry
from edge.cli.arguments import plugin_options
from edge.core.errors import ConfigError, GelgateError
from edge.core.plugins import Resettable

__all__ = ["devices"]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for a program.")]
DeviceName = Annotated[str | None, typer.Option("--device", help="Use this plugin only.")]
OptionTexts = Annotated[
    list[str] | None, typer.Option("--option", help="An option of that plugin, as name=value.")
]
Reset = Annotated[
    bool, typer.Option(help="Reset the sensor that --device and --option select, as a re-plug does.")
]


_KINDS: Final[dict[str, tuple[registry.PluginGroup, Callable[[str], Any]]]] = {
    "sensor": ("devices", registry.device),
    "overview": ("overviews", registry.overview),
    "trigger": ("triggers", registry.trigger),
    "actuator": ("actuators", registry.actuator),
}


def devices(
    as_json: AsJson = False, device: DeviceName = None, option: OptionTexts = None, reset: Reset = False
) -> None:
    """List the plugged-in cameras, pedals and relays.

    They are listed by plugin; a device that is refused with the reason. --device names the plugin of a sensor."""
    if (option or reset) and device is None:
        raise ConfigError("--option and --reset belong to one plugin; name it with --device")
    plugins = [(kind, name) for kind, (group, _) in _KINDS.items() for name in registry.names(group)]
    if device is not None:
        sensor, plugins = registry.device(device), [("sensor", device)]
        if reset:
            if not isinstance(sensor, Resettable):
                raise ConfigError(f"the device plugin '{device}' has nothing to reset")
            options = plugin_options("devices", device, sensor.Options, option or [])
            typer.echo(f"reset {sensor.reset(options)}")
    # A plugin that is a sensor and an overview camera is listed as a sensor.
    wanted = [(kind, name) for kind, name in plugins if kind != "overview" or ("sensor", name) not in plugins]
    reports = [_report(kind, name, option or []) for kind, name in wanted]
    if as_json:
        typer.echo(json.dumps(reports, indent=2, ensure_ascii=False))
    else:
        for report in reports:
            typer.echo(_as_text(report))


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
