"""Alarms that must be raised, and cleared, within a stated time (docs/operations.md)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from simulation.lives import Station
from simulation.plc import Server
from simulation.sensor import SERIAL, S
from simulation.surroundings import World


@dataclass(frozen=True)
class Rule:
    """alarm: raised when `is_so` was so for `raised_s`; it may be raised while `may_be`; cleared `cleared_s` after."""

    alarm: str
    is_so: Callable[[World, Station], bool]
    raised_s: float
    may_be: Callable[[World, Station], bool]
    cleared_s: float


def is_sensor_lost(world: World, station: Station) -> bool:
    """Tell whether nobody can see the gel now."""
    sensor = world.sensor
    is_silent = sensor.is_silent or sensor.is_frozen or sensor.is_covered or sensor.is_holding
    is_broken = sensor.damage[0] != "" and sensor.damage[1] == 1.0
    return not sensor.is_plugged or sensor.serial != SERIAL or is_silent or is_broken


def _is_sensor_disturbed(world: World, station: Station) -> bool:
    """Something is wrong with it, which may raise the alarm or not."""
    return bool(world.sensor.troubles)


def _is_relay_away(world: World, station: Station) -> bool:
    return world.relay.mood == "unplugged"


def _is_relay_disturbed(world: World, station: Station) -> bool:
    return world.relay.mood != "up"


def _is_pedal_away(world: World, station: Station) -> bool:
    return world.pedal.mood == "unplugged"


def _may_be_pressed(world: World, station: Station) -> bool:
    return world.hand.press is not None or bool(world.sensor.troubles)


def _is_plc_silent(world: World, station: Station) -> bool:
    return world.has_plc and len(world.plcs) == 1 and world.plcs[0].mood in ("cut", "mute")


def _may_plc_be_named(world: World, station: Station) -> bool:
    """Its watchdog stands still, or a result waits for its acknowledgement."""
    return world.has_plc and (world.plcs[0].mood != "up" or len(world.plcs) > 1 or Server.now.has_result)


def _never(world: World, station: Station) -> bool:
    return False


def _is_disk_disturbed(world: World, station: Station) -> bool:
    return station.is_disk_disturbed


RULES = (
    # Two seconds without a picture are a fault; 38 frames in a row that cannot be read are.
    Rule("device", is_sensor_lost, 6.5, _is_sensor_disturbed, 14.0),
    # Its presence is asked for once a second; it is opened again every 0.5 to 5 s, and a second.
    Rule("actuator", _is_relay_away, 2.5, _is_relay_disturbed, 8.0),
    Rule("trigger_device", _is_pedal_away, 2.5, _is_pedal_away, 8.0),
    # A second without a beat; after a cable that was pulled its own old connection may write for three seconds.
    Rule("plc", _is_plc_silent, 2.5, _may_plc_be_named, 6.0),
    # It ends when the gel is seen free.
    Rule("contact", _never, 0.0, _may_be_pressed, 8.0),
    # It ends when the gel is seen free.
    Rule("gel_overload", _never, 0.0, _may_be_pressed, 8.0),
    # It ends with the next press that is recorded, or with the next report, every 10 s.
    Rule("store", _never, 0.0, _is_disk_disturbed, 14.0),
)


def audit_alarms(world: World, station: Station) -> Iterator[str]:
    """Compare what is so with the alarms that the station raises. A process that gets no time says nothing."""
    now_ns, is_held_up = world.clock.now_ns, station.is_held_up
    view = station.loop.parts.status.view()
    raised = view.alarms
    mended = {"actuator": world.relay.well_since_ns, "trigger_device": world.pedal.well_since_ns}
    if world.has_plc:
        mended["plc"] = world.plcs[0].well_since_ns  # a cut may be over between two looks
    for rule in RULES:
        is_so, may = rule.is_so(world, station), rule.may_be(world, station)
        # A sensor that is opened again may be well, until it is found that it is not; a frozen one stays the same.
        # A pause between pictures that show nothing is not their blindness.
        sensor = world.sensor
        again = (sensor.given if sensor.is_frozen else sensor.openings, sensor.is_silent, sensor.is_holding)
        so_since_ns = station.so_since(f"{rule.alarm} is so", is_so and not is_held_up, again)
        mended_ns = mended.get(rule.alarm)
        well_since_ns = station.so_since(f"{rule.alarm} is well", not (is_so or may or is_held_up), mended_ns)
        is_late = so_since_ns is not None and now_ns - so_since_ns > rule.raised_s * S
        if is_late and rule.alarm not in raised:
            yield f"the alarm {rule.alarm} is not raised {rule.raised_s} s after its reason came"
        if rule.alarm == "device" and is_late and view.state == "ready":
            yield f"nothing was seen for more than {rule.raised_s} s, and the station is ready"
        if rule.alarm in ("device", "store") and rule.alarm in raised and view.state == "ready":
            yield f"the station is ready, and the alarm {rule.alarm} is raised"
        if well_since_ns is not None and now_ns - well_since_ns > rule.cleared_s * S and rule.alarm in raised:
            yield f"the alarm {rule.alarm} is still raised {rule.cleared_s} s after its reason went"
