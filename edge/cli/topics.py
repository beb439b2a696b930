"""`gelgate station topics`: every topic and its payload, printed from the payload models."""

from edge.gateway.command_table import every_command
from edge.messaging.topic_reference import reference

__all__ = ["topics"]


def topics() -> None:
    """Print every MQTT topic and field, as in docs/mqtt.md."""
    print(reference(every_command()), end="")
