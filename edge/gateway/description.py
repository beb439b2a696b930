"""What a configured station tells others about itself."""

from dataclasses import dataclass
from importlib.metadata import version

from edge.config import Config
from edge.gateway.command_table import station_commands
from edge.messaging.descriptions.station import DescribedStation, SparkplugNode

__all__ = ["DescribedBroker", "broker_of", "describe_station"]


def describe_station(config: Config) -> DescribedStation:
    """Describe the station of this configuration, with the commands that it serves."""
    commands = config.commands
    served = {*commands.unsigned, *commands.signed}
    return DescribedStation(
        root=config.station.place.root,
        place=str(config.station.place),
        version=version("gelgate"),
        commands=[one for one in station_commands(config) if one.verb in served],
        signed=commands.signed,
    )


@dataclass(frozen=True)
class DescribedBroker:
    """The broker of a station. discovery_prefix, node: of Home Assistant and of Sparkplug, None where the station has
    none."""

    host: str = "localhost"
    port: int = 1883
    has_tls: bool = False
    user: str = ""
    """The station's name there."""
    discovery_prefix: str | None = None
    node: SparkplugNode | None = None


def broker_of(config: Config) -> DescribedBroker:
    """Return the broker of the first `mqtt` sink; a station without one is described with the usual values."""
    options = next((sink.options for sink in config.sinks if sink.plugin == "mqtt"), {})
    node = next((sink.options for sink in config.sinks if sink.plugin == "sparkplug"), None)
    has_tls = options.get("tls") is not None
    return DescribedBroker(
        host=str(options.get("host", "localhost")),
        port=int(options.get("port") or (8883 if has_tls else 1883)),
        has_tls=has_tls,
        user=str(options.get("username") or config.station.station),
        discovery_prefix=options.get("home_assistant"),
        node=None
        if node is None
        else SparkplugNode.of(describe_station(config).root, node.get("group"), node.get("node")),
    )
