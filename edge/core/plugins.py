"""The protocols of entry points: one for each group, and the optional abilities of a plugin.

An entry point is always `package.module:value`, and the value is an object that meets the group's protocol:

    gelgate.devices    DevicePlugin
    gelgate.overviews  DevicePlugin: an overview camera is a source of frames, too
    gelgate.sinks      SinkPlugin
    gelgate.triggers   TriggerPlugin
    gelgate.actuators  ActuatorPlugin
    gelgate.handshakes HandshakePlugin
    gelgate.detectors  Detector, in edge.core.detector
    gelgate.backbones  Backbone
    gelgate.features   a class of PressStage, in edge.press_stage

A plugin has an optional ability by having its attributes; the program asks `isinstance(plugin, Resettable)`. What
`open` returns is in `edge.core.ports`. docs/plugins.md shows plugins of other authors.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar, runtime_checkable

from edge.core.digital_io import Actuator, DiscoveredPort, Trigger
from edge.core.ports import Clock, Device, DiscoveredDevice, Sink
from edge.core.sink_context import Station

if TYPE_CHECKING:
    from pydantic import BaseModel

    from edge.core.handshake import HandshakeServer

__all__ = [
    "ActuatorPlugin",
    "Backbone",
    "DevicePlugin",
    "HandshakePlugin",
    "HasAddress",
    "HasFacts",
    "HasIdentity",
    "HasWarnings",
    "Played",
    "PlaysRecording",
    "RecordsDialogue",
    "Resettable",
    "SinkPlugin",
    "TriesLogin",
    "TriggerPlugin",
]

OptionsT = TypeVar("OptionsT", bound="BaseModel")
AnyOptions = TypeVar("AnyOptions", bound="BaseModel", contravariant=True)


@runtime_checkable
class DevicePlugin(Protocol[OptionsT]):
    """Finds and opens sensors of one kind. Optional: `Resettable`, `PlaysRecording`, `RecordsDialogue`.

    `Options` validates the plugin's TOML table and refuses unknown keys. The same options value is passed to every
    `open`, so a device that is opened again after a fault is the same one. Options with a field `controls`, a
    mapping of V4L2 names to values, get those of the bundle's sensor profile.
    """

    @property
    def Options(self) -> type[OptionsT]: ...

    def discover(self, options: OptionsT) -> Sequence[DiscoveredDevice]:
        """Every device found that is, or looks like, this plugin's sensor, in a fixed order."""

    def open(self, options: OptionsT, clock: Clock) -> Device:
        """The sensor selected by the options. Errors: DeviceNotFound, DeviceBusy, DeviceLost, RecordingError."""


@runtime_checkable
class Resettable(Protocol[AnyOptions]):
    """A device plugin that can reset its sensor, as unplugging and plugging in would."""

    def reset(self, options: AnyOptions) -> str:
        """Reset the sensor selected by the options, and return its name. Errors: as `DevicePlugin.open`."""


@runtime_checkable
class RecordsDialogue(Protocol[AnyOptions]):
    """A device plugin that can keep what its driver and a sensor say to each other."""

    def record_dialogue(self, options: AnyOptions, clock: Clock) -> Sequence[str]:
        """Open the sensor selected by the options for some frames; returns the lines of a file, in which no picture can
        be seen. Errors: DeviceNotFound."""


@runtime_checkable
class Played(Protocol):
    """A recording, to which a run that played it is compared."""

    def check_presses(self, seen: int, frames: int, dropped: int) -> None:
        """Compare the presses that a run saw until the end. frames, dropped: delivered, and of these not processed.
        Errors: PressesMissed where it missed one, or may have."""


@runtime_checkable
class PlaysRecording(Protocol[AnyOptions]):
    """A device plugin that plays a recording: a run can then check that it missed no press."""

    def recording(self, options: AnyOptions) -> Played:
        """Open what is played. Errors: RecordingError."""


@runtime_checkable
class SinkPlugin(Protocol[OptionsT]):
    """Opens receivers of messages. Optional, for `Options`: `HasAddress`, `TriesLogin`, `HasIdentity`,
    `HasWarnings`."""

    @property
    def Options(self) -> type[OptionsT]: ...

    def open(self, options: OptionsT, station: Station) -> Sink:
        """A sink of the station. It returns at once: a receiver that is away is not an error.

        Errors: ConfigError for options that can never work, such as a certificate that is not there.
        """


@runtime_checkable
class HasAddress(Protocol):
    """Options of a sink that connects to a network address, which `gelgate check` tries."""

    def address(self) -> tuple[str, int]:
        """(host, port). Errors: ConfigError for options that can never work."""


@runtime_checkable
class TriesLogin(HasAddress, Protocol):
    """Options of a sink whose receiver may refuse the station; `gelgate check` asks it."""

    def try_login(self) -> str:
        """Say, in one sentence, who lets the station in. Errors: SinkRejected where it does not, which a person has to
        correct; SinkUnavailable."""


@runtime_checkable
class HasIdentity(Protocol):
    """Options of a sink that say which receiver it is, so that the outbox knows it at any place in the file."""

    def identity(self) -> str:
        """Such as `host:port`; the same for the same receiver."""


@runtime_checkable
class HasWarnings(Protocol):
    """Options of a sink that can work, and that a person should think about; `gelgate check` prints them."""

    def warnings(self) -> Sequence[str]:
        """List warnings, one sentence for each. Errors: ConfigError for options that can never work."""


@runtime_checkable
class TriggerPlugin(Protocol[OptionsT]):
    """Finds and opens pedals and buttons of one kind. The same options value is passed to every `open`."""

    @property
    def Options(self) -> type[OptionsT]: ...

    def discover(self, options: OptionsT) -> Sequence[DiscoveredPort]:
        """Every device found that is, or looks like, one of this kind, in a fixed order. Errors: ConfigError for a
        package that is not installed."""

    def open(self, options: OptionsT, clock: Clock) -> Trigger:
        """The device selected by the options. Errors: DeviceNotFound, DeviceBusy, DeviceLost."""


@runtime_checkable
class ActuatorPlugin(Protocol[OptionsT]):
    """Finds and opens relay boards, lights and buzzers of one kind. Every `open` gets the same options value."""

    @property
    def Options(self) -> type[OptionsT]: ...

    def discover(self, options: OptionsT) -> Sequence[DiscoveredPort]:
        """Every device found that is, or looks like, one of this kind, in a fixed order. It switches nothing. Errors:
        ConfigError for a package that is not installed."""

    def open(self, options: OptionsT, clock: Clock) -> Actuator:
        """The device selected by the options; its outputs stay as they are. Errors: DeviceNotFound, DeviceBusy,
        DeviceLost."""


@runtime_checkable
class HandshakePlugin(Protocol[OptionsT]):
    """Serves the handshake to a PLC, in one protocol."""

    @property
    def Options(self) -> type[OptionsT]: ...

    def open(self, options: OptionsT, clock: Clock) -> "HandshakeServer":
        """Take the port; nothing is served before `start`. Errors: ConfigError for a port that cannot be taken, and for
        a package that is not installed."""


@runtime_checkable
class Backbone(Protocol):
    """Gives trunks: frames in, named feature maps out. Optional: `HasFacts`."""

    @property
    def name(self) -> str: ...

    def trunk(self, taps: Sequence[str] = ...) -> bytes:
        """The serialised ONNX graph with at least these taps; without an argument, with its usual ones.

        Input `frames` uint8 RGB (n, h, w, 3); every tap an output float32 (n, c, h', w'). Errors: ConfigError for a
        tap that it does not have.
        """


@runtime_checkable
class HasFacts(Protocol):
    """A backbone that knows the origin of its weights."""

    def facts(self) -> Mapping[str, object]:
        """Plain JSON, for the manifest of every bundle that is fitted on it."""
