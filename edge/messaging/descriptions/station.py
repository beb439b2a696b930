"""What the descriptions of a station need to know of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Self

from edge.messaging.command_payloads import CommandArguments

__all__ = ["DescribedStation", "ServedCommand"]


@dataclass(frozen=True)
class ServedCommand:
    """A verb that the station serves. is_signed: only with a signature."""

    verb: str
    arguments: type[CommandArguments]
    help: str
    is_signed: bool = False


@dataclass(frozen=True)
class DescribedStation:
    """root: of its topics. place: site/line/station. version: of gelgate."""

    root: str
    place: str
    version: str
    commands: Sequence[ServedCommand] = ()

    @classmethod
    def of_root(cls, root: str) -> Self:
        """The station of these topics, `<prefix>/<site>/<line>/<station>/gel/v1`, without its commands."""
        return cls(root, "/".join(root.split("/")[1:-2]), version("gelgate"))

    @property
    def id(self) -> str:
        """Letters, digits, `-` and `_` alone; two stations of a plant have different ones."""
        return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in self.root)
