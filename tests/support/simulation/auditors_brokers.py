"""What holds of the connections, as the brokers see them (docs/operations.md, docs/mqtt.md)."""

from collections.abc import Iterator

from simulation.brokers import Broker
from simulation.lives import Station
from simulation.sensor import S
from simulation.surroundings import World

UNHELD_S = 1.5
"""So long `online` may stand when the second connection has just ended: its will is on the way."""


def audit_availability(world: World, station: Station) -> Iterator[str]:
    """`online` stands only where the broker holds the will that takes it back."""
    for broker in world.brokers.values():
        is_held = any(link.is_second and link.will is not None for link in broker.links)
        is_current = "availability" not in broker.stale
        is_false = broker.retained.get("availability") == b"online" and is_current and not is_held
        since_ns = station.so_since(f"{broker.name} holds no will", is_false and broker.mood != "silent")
        if since_ns is not None and world.clock.now_ns - since_ns > UNHELD_S * S:
            yield f"{broker.name} retains `online`, and holds no will"


def audit_levels(world: World) -> Iterator[str]:
    """Silence never leads to 3.1.1, unless the broker answers there between two silences at 5."""
    for broker in world.brokers.values():
        if broker.level == "5":
            yield from _audit_level(broker)


def _audit_level(broker: Broker) -> Iterator[str]:
    was_probed = False
    for level, has_will, is_accepted in broker.connects:
        if level == "5" and is_accepted:
            was_probed = False
        elif level == "3.1.1" and not has_will:
            was_probed = True
        elif level == "3.1.1" and not was_probed:
            yield f"{broker.name} speaks 5, and was connected to at 3.1.1 without another question"
            return
