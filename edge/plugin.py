"""What a device's or a sink's entry point names: a factory with its options."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

from pydantic import BaseModel

from edge.core.ports import Clock, Device, DeviceIdentity, Sighting, Sink
from edge.core.sink_context import Station

__all__ = ["DevicePlugin", "SinkPlugin"]

OptionsT = TypeVar("OptionsT", bound=BaseModel)


class DevicePlugin(Protocol[OptionsT]):
    """The object behind an entry point in `gelgate.devices`.

    `Options` validates the plugin's TOML table and refuses unknown keys. The same options value is passed to every
    `open`, so a device that is opened again after a fault is the same one.
    """

    @property
    def Options(self) -> type[OptionsT]: ...

    def survey(self, options: OptionsT) -> Sequence[Sighting]:
        """Everything in reach that is, or looks like, this plugin's sensor."""
        ...

    def find(self, options: OptionsT) -> list[DeviceIdentity]:
        """The sensors that `open` could open, in a fixed order."""
        ...

    def open(self, options: OptionsT, clock: Clock) -> Device:
        """The one sensor that the options mean. Errors: DeviceNotFound, DeviceBusy, DeviceLost, RecordingError."""
        ...


class SinkPlugin(Protocol[OptionsT]):
    """The object, often a module, behind an entry point in `gelgate.sinks`.

    `Options` of a sink that connects to somewhere have `address() -> (host, port)`, which is tried before the start; it
    raises ConfigError for options that can never work.
    """

    @property
    def Options(self) -> type[OptionsT]: ...

    def open(self, options: OptionsT, station: Station) -> Sink:
        """A sink that speaks for the station. It returns at once: a receiver that is away is no error.

        Errors: ConfigError for options that can never work, such as a certificate that is not there.
        """
        ...
