"""`gelgate devices`: sensors, overview cameras, pedals and relays that are plugged in, and why one is refused."""

import json
from collections.abc import Callable, Sequence
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


def devices(
    as_json: AsJson = False, device: DeviceName = None, option: OptionTexts = None, reset: Reset = False
) -> None:
    """List the plugged-in cameras, pedals and relays.

    They are listed by plugin; a device that is refused with the reason. --device names the plugin of a sensor."""
    if (option or reset) and device is None:
        raise ConfigError("--option and --reset belong to one plugin; name it with --device")
    if reset and device is not None:
        _reset(device, option or [])
    if device is not None:
        registry.device(device)  # a wrong name is refused; a plugin that cannot search is reported
    groups: Sequence[tuple[registry.PluginGroup, str]] = [("devices", device)] if device else _every_plugin()
    reports = [_report(group, name, option or []) for group, name in groups]
    if as_json:
        typer.echo(json.dumps(reports, indent=2, ensure_ascii=False))
    else:
        for report in reports:
            typer.echo(_as_text(report))


_KINDS: Final[dict[registry.PluginGroup, str]] = {
    "devices": "sensor",
    "overviews": "overview",
    "triggers": "trigger",
    "actuators": "actuator",
}
_FINDERS: Final[dict[registry.PluginGroup, Callable[[str], Any]]] = {
    "devices": registry.device,
    "overviews": registry.overview,
    "triggers": registry.trigger,
    "actuators": registry.actuator,
}


def _every_plugin() -> Sequence[tuple[registry.PluginGroup, str]]:
    """Group and name; a plugin that is a sensor and an overview camera is listed as a sensor."""
    plugins = [(group, name) for group in _KINDS for name in registry.names(group)]
    return [plugin for plugin in plugins if plugin[0] != "overviews" or ("devices", plugin[1]) not in plugins]


def _report(group: registry.PluginGroup, name: str, given: list[str]) -> dict[str, Any]:
    """Search with a plugin; say why where it cannot (a missing option, a missing package)."""
    report: dict[str, Any] = {"plugin": name, "kind": _KINDS[group], "seen": [], "note": ""}
    try:
        plugin = _FINDERS[group](name)
        missing = [key for key, field in plugin.Options.model_fields.items() if field.is_required()]
        if missing and not given:
            return {**report, "note": _needs(group, missing[0])}
        options = plugin_options(group, name, plugin.Options, given)
        seen = [asdict(device) for device in plugin.discover(options)]
        return {**report, "seen": seen, "note": "" if seen else "nothing found"}
    except GelgateError as error:
        if given:
            raise
        return {**report, "note": str(error)}


def _needs(group: registry.PluginGroup, option: str) -> str:
    if group == "devices":
        return f"needs --option {option}=..."
    return f"needs options.{option}; `gelgate check` looks for the configured one"


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


def _reset(name: str, given: list[str]) -> None:
    plugin = registry.device(name)
    if not isinstance(plugin, Resettable):
        raise ConfigError(f"the device plugin '{name}' has nothing to reset")
    typer.echo(f"reset {plugin.reset(plugin_options('devices', name, plugin.Options, given))}")
