"""`gelgate station topics`: every topic and its payload, printed from the payload models."""

__all__ = ["topics"]


def topics() -> None:
    """Print every MQTT topic and field, as in docs/mqtt.md."""
    from edge.gateway.command_table import every_command
    from edge.messaging.topic_reference import reference

    print(reference(every_command()), end="")
