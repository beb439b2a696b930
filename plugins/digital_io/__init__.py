"""Pedals, buttons, lights and relays: HID and GPIO drivers, and a virtual HID bus."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from pydantic import BaseModel

from edge.core.digital_io import DiscoveredPort
from edge.core.ports import Clock

__all__ = ["PortPlugin"]

OptionsT = TypeVar("OptionsT", bound=BaseModel)
PortT = TypeVar("PortT")


@dataclass(frozen=True)
class PortPlugin(Generic[OptionsT, PortT]):
    """A plugin of two functions, as `edge.core.plugins` describes them."""

    Options: type[OptionsT]
    discover: Callable[[OptionsT], Sequence[DiscoveredPort]]
    open: Callable[[OptionsT, Clock], PortT]
