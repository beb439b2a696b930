"""`gelgate topics`: what is published where, printed from the payload models."""

__all__ = ["topics"]


def topics() -> None:
    """Print the MQTT reference: every topic and every field, as in docs/mqtt.md."""
    from edge.gateway.commands import COMMANDS
    from edge.messaging.topic_reference import reference

    print(reference(COMMANDS), end="")
