"""Access rules of mosquitto: what a station needs and no more, and a reader that changes nothing.

Ref: mosquitto.conf(5), acl_file.
"""

from edge.messaging.descriptions.dashboards import discovery_topic
from edge.messaging.descriptions.station import PUBLISHED, REQUESTED, DescribedStation, SparkplugNode
from edge.messaging.topics import TOPICS

__all__ = ["access_rules"]

_HEAD = """\
# Who may do what at the broker. A name that is not here may do nothing.
# mosquitto.conf: `acl_file` with this file, `allow_anonymous false`, and a `password_file` with these names, or
# `require_certificate true` with `use_identity_as_username true`.
"""


def access_rules(
    station: DescribedStation,
    user: str,
    discovery_prefix: str | None = None,
    node: SparkplugNode | None = None,
) -> str:
    """The lines of an `acl_file`. user: the station's name at the broker. discovery_prefix: of Home Assistant, where
    the station announces itself there. node: of Sparkplug, where the station is one."""
    names = [topic.name.replace("<press id>", "+").replace("<alarm>", "+") for topic in TOPICS]
    sent = [name for name in names if not name.startswith("cmd/")]
    writes = [*(f"{station.root}/{name}" for name in sent), f"{station.root}/cmd/+/response"]
    if discovery_prefix is not None:
        writes.append(discovery_topic(station, discovery_prefix))
    reads = [f"{station.root}/cmd/+"]
    if node is not None:
        writes += map(node.topic, PUBLISHED)
        reads.append(node.topic(REQUESTED))
    return "\n".join(
        [
            _HEAD,
            f"# The station {station.place}: its own topics, and requests to it.",
            f"user {user}",
            *(f"topic write {topic}" for topic in writes),
            *(f"topic read {topic}" for topic in reads),
            "",
            "# Sees what the station says, and no request.",
            "user reader",
            *(f"topic read {station.root}/{name}" for name in sent),
            "",
        ]
    )
