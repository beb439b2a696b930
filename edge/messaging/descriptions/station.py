"""What the descriptions of a station need to know of it, and the names of its Sparkplug B edge node."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, Self

from pydantic import BaseModel

from edge.extras import find_version

__all__ = ["PUBLISHED", "REQUESTED", "DescribedCommand", "DescribedStation", "SparkplugNode"]

PUBLISHED: Final = ("NBIRTH", "NDATA", "NDEATH")
"""What a Sparkplug node without devices publishes. Ref: Eclipse Sparkplug 3.0.0, 4.1 (topic namespace)."""

REQUESTED: Final = "NCMD"
"""What it is asked with."""


class DescribedCommand(Protocol):
    """A request to a station: its verb, the model of its arguments, what it does, and what it changes for good."""

    @property
    def verb(self) -> str: ...
    @property
    def arguments(self) -> type[BaseModel]: ...
    @property
    def help(self) -> str: ...
    @property
    def changes(self) -> str: ...


@dataclass(frozen=True)
class DescribedStation:
    """root: of its topics. place: site/line/station. version: of gelgate."""

    root: str
    place: str
    version: str
    commands: Sequence[DescribedCommand] = ()
    """The commands that it serves."""
    signed: Collection[str] = ()
    """Verbs that it serves only with a signature."""
    picture_type: str = "image/jpeg"
    """Content type of the pictures of presses."""
    keeps_heatmap: bool = False
    """Whether the newest picture is retained on `last/heatmap`; otherwise the topic is empty."""

    @classmethod
    def of_root(cls, root: str) -> Self:
        """The station of these topics, `<prefix>/<site>/<line>/<station>/gel/v1`, without its commands."""
        return cls(root, "/".join(root.split("/")[1:-2]), find_version("gelgate"))

    @property
    def id(self) -> str:
        """Letters, digits, `-` and `_` alone; two stations of a plant have different ones."""
        return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in self.root)


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
