"""The names of a station as a Sparkplug B edge node. Ref: Eclipse Sparkplug 3.0.0, 4.1 (topic namespace)."""

from dataclasses import dataclass
from typing import Final, Self

__all__ = ["PUBLISHED", "REQUESTED", "SparkplugNode"]

PUBLISHED: Final = ("NBIRTH", "NDATA", "NDEATH")
"""What a node without devices publishes."""

REQUESTED: Final = "NCMD"
"""What it is asked with."""


@dataclass(frozen=True)
class SparkplugNode:
    """group, name: the ids of group and edge node; both are one level of a topic."""

    group: str
    name: str

    @classmethod
    def of(cls, root: str, group: str | None = None, node: str | None = None) -> Self:
        """Name the node; by default the site is the group, `<line>-<station>` the node. root: of the topics."""
        _, site, line, station = root.split("/")[:4]
        return cls(group or site, node or f"{line}-{station}")

    def topic(self, verb: str) -> str:
        """Give the topic of one of its messages."""
        return f"spBv1.0/{self.group}/{verb}/{self.name}"

    def __str__(self) -> str:
        return f"{self.group}/{self.name}"
