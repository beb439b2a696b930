"""`gelgate devices`: sensors, overview cameras, pedals and relays that are plugged in, and why one is refused."""

from typing import Annotated, Any, Final, Literal

import typer

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
    """List the plugged-in sensors, overview cameras, pedals and relays.

    They are listed by plugin; a device that is refused with the reason. --device names the plugin of a sensor."""
    from edge import registry
    from edge.core.errors import ConfigError

    if (option or reset) and device is None:
        raise ConfigError("--option and --reset belong to one plugin; name it with --device")
    if reset and device is not None:
        _reset(device, option or [])
    if device is not None:
        registry.device(device)  # a wrong name is refused; a plugin that cannot search is reported
    reports = [_report(name, option or []) for name in ([device] if device else registry.names("devices"))]
    if device is None:
        cameras = [name for name in registry.names("overviews") if name not in registry.names("devices")]
        reports += [_report(name, [], "overviews") for name in cameras]
        reports += [_port_report(group, name) for group in _PORTS for name in registry.names(group)]
    if as_json:
        import json

        typer.echo(json.dumps(reports, indent=2, ensure_ascii=False))
    else:
        for report in reports:
            typer.echo(_as_text(report))


def _report(
    name: str, given: list[str], group: Literal["devices", "overviews"] = "devices"
) -> dict[str, Any]:
    """What a plugin finds, or why it cannot search (a missing option, a missing package)."""
    from dataclasses import asdict

    from edge import registry
    from edge.cli.plugin_options import plugin_options
    from edge.core.errors import GelgateError

    about = {"plugin": name, "kind": "sensor" if group == "devices" else "overview"}
    try:
        plugin = registry.device(name) if group == "devices" else registry.overview(name)
        missing = [key for key, field in plugin.Options.model_fields.items() if field.is_required()]
        if missing and not given:
            return {**about, "seen": [], "note": f"needs --option {missing[0]}=..."}
        seen = plugin.discover(plugin_options(group, name, plugin.Options, given))
        return {
            **about,
            "seen": [asdict(one) for one in seen],
            "note": "" if seen else "nothing found",
        }
    except GelgateError as error:
        if given:
            raise
        return {**about, "seen": [], "note": str(error)}


_PORTS: Final[tuple[Literal["triggers", "actuators"], ...]] = ("triggers", "actuators")


def _port_report(group: Literal["triggers", "actuators"], name: str) -> dict[str, Any]:
    """What a plugin of pedals or relays finds with its usual options, or why it cannot search."""
    from dataclasses import asdict

    from edge import registry
    from edge.core.errors import GelgateError

    report: dict[str, Any] = {"plugin": name, "group": group, "seen": [], "note": ""}
    try:
        plugin = registry.trigger(name) if group == "triggers" else registry.actuator(name)
        missing = [key for key, field in plugin.Options.model_fields.items() if field.is_required()]
        if missing:
            return {
                **report,
                "note": f"needs options.{missing[0]}; `gelgate check` looks for the configured one",
            }
        seen = [asdict(one) for one in plugin.discover(plugin.Options())]
        return {**report, "seen": seen, "note": "" if seen else "nothing found"}
    except GelgateError as error:
        return {**report, "note": str(error)}


def _as_text(report: dict[str, Any]) -> str:
    group = f" ({report['group']})" if "group" in report else ""
    lines = [f"{report['plugin']}{group}:{' ' + report['note'] if report['note'] else ''}"]
    for one in report["seen"]:
        who = one.get("identity")
        if "group" in report and one["refusal"] is None:
            serial = f", serial {one['serial']}" if one["serial"] else ""
            lines.append(f"  found    {one['product']}{serial}, {one['place']}")
        elif who is None:
            lines.append(f"  refused  {one['place']}: {one['refusal']}")
        else:
            mode = f"{who['mode'][0]}x{who['mode'][1]}"
            rate = f" at nominal {who['nominal_fps']:g} fps" if who["nominal_fps"] else ""
            lines.append(
                f"  {report['kind']:<8} {who['product']}, serial {who['serial']}, {mode}{rate}, {one['place']}"
            )
    return "\n".join(lines)


def _reset(name: str, given: list[str]) -> None:
    from edge import registry
    from edge.cli.plugin_options import plugin_options
    from edge.core.errors import ConfigError
    from edge.core.plugins import Resettable

    plugin = registry.device(name)
    if not isinstance(plugin, Resettable):
        raise ConfigError(f"the device plugin '{name}' has nothing to reset")
    typer.echo(f"reset {plugin.reset(plugin_options('devices', name, plugin.Options, given))}")
