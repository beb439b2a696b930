"""A virtual GelSight Mini on a virtual USB bus; it plays a recording through the driver of the real sensor.

What is real: everything above pyusb's backend interface (identity by product string, kernel driver, negotiation,
alternate settings, packets, reassembly, freshness, unplugging). An unrelated webcam with the same vendor and product id
is on the same bus.

What it does not simulate: electrical and timing effects of a bus (no jitter, no lost micro-frames unless scripted, no
bandwidth limit); frames lost because the host reads too slowly (they come late instead); exposure and the effect of
camera controls on a picture; the V4L2 path; a JPEG encoder. A recording's JPEGs are sent unchanged, its PNG frames as
JPEG of quality 95.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr

from edge.clock import SystemClock
from edge.core.errors import FrameCorrupt
from edge.core.imaging.image_bytes import comment, kind, with_comment
from edge.core.plugins import DevicePlugin, RecordsDialogue
from edge.core.ports import Clock, Device, DiscoveredDevice
from edge.recording.format import Recording, RecordingHeader
from plugins.devices.uvc.dialogue import record_dialogue
from plugins.devices.uvc.identity import choose, discover
from plugins.devices.uvc.stream import UvcSensor
from plugins.devices.virtual.bus import VirtualBus
from plugins.devices.virtual.camera import VirtualCamera
from plugins.devices.virtual.descriptors import WEBCAM, Board
from plugins.devices.virtual.faults import Fault

__all__ = ["Bench", "UsbMock", "UsbMockOptions", "plugin"]

_JPEG_QUALITY = 95


def _fault(value: object) -> object:
    return Fault.parse(value) if isinstance(value, str) else value


class UsbMockOptions(BaseModel):
    """The TOML table of a virtual sensor. One options value is one bus: opened again, it continues from its last
    frame."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    recording: Path = Field(
        description="the folder to play, made by `gelgate record` or `gelgate lab simulate`"
    )
    serial: str | None = Field(default=None, description="instead of the recorded one")
    pace: float = Field(
        default=1.0,
        ge=0,
        le=1000,
        description="1 plays at the recorded times, 2 twice as fast, 0 as fast as frames are read; with 0 frames "
        "have the recorded times, so contact is found as in real time and no frame is dropped; with 2 and more a "
        "recording may be too short to learn the free gel",
    )
    loop: bool = Field(default=False, description="start over at the end")
    faults: tuple[Annotated[Fault, BeforeValidator(_fault)], ...] = Field(
        default=(), description='texts such as "drop@12", "stall@40:2.5", "unplug@80:1": kind, frame, seconds'
    )
    with_webcam: bool = Field(
        default=True, description="also plug in an unrelated webcam with the same USB id"
    )
    neighbours: tuple[str, ...] = Field(
        default=(), description="serials of other sensors on the same bus, which show the same recording"
    )
    controls: dict[str, int] = Field(
        default_factory=dict,
        description="pinned as on the real sensor; they change nothing in a recorded picture",
    )

    _bench: "Bench | None" = PrivateAttr(default=None)


class Bench:
    """The virtual bus of one options value, with its sensor and webcam. Tests and demonstrations unplug the sensor
    here."""

    def __init__(self, options: UsbMockOptions, clock: Clock) -> None:
        recording = Recording.open(options.recording)
        self.bus = VirtualBus(clock)
        self.sensor = VirtualCamera(
            _board(recording.header, options.serial),
            _Payloads(recording),
            clock,
            gaps_ns=recording.gaps_ns(),
            pace=options.pace,
            loop=options.loop,
            faults=options.faults,
        )
        if options.with_webcam:
            self.bus.plug_in(VirtualCamera(WEBCAM, (), clock, port=2))
        for port, serial in enumerate(options.neighbours, 3):
            self.bus.plug_in(
                VirtualCamera(
                    _board(recording.header, serial),
                    _Payloads(recording),
                    clock,
                    gaps_ns=recording.gaps_ns(),
                    port=port,
                )
            )
        self.bus.plug_in(self.sensor)


class UsbMock(DevicePlugin[UsbMockOptions], RecordsDialogue[UsbMockOptions]):
    """The plugin."""

    Options = UsbMockOptions

    def bench(self, options: UsbMockOptions, clock: Clock | None = None) -> Bench:
        """The bus of these options, made at its first use. Errors: RecordingError."""
        if options._bench is None:
            options._bench = Bench(options, clock or SystemClock())
        return options._bench

    def discover(self, options: UsbMockOptions) -> list[DiscoveredDevice]:
        return [sensor.discovered for sensor in discover(self.bench(options).bus)]

    def recording(self, options: UsbMockOptions) -> Recording:
        return Recording.open(options.recording)

    def open(self, options: UsbMockOptions, clock: Clock) -> Device:
        """Open the sensor. Errors: RecordingError, DeviceNotFound, DeviceBusy (also by a process that plays it)."""
        bench = self.bench(options, clock)
        on_bus = choose(discover(bench.bus), options.serial)
        sensor = UvcSensor.open(
            bench.bus, on_bus, clock, lock_name=_lock_name(options), controls=options.controls
        )
        if options.pace == 0:
            sensor.played_ns = bench.sensor.played_ns
        return sensor

    def record_dialogue(self, options: UsbMockOptions, clock: Clock) -> list[str]:
        """Record it on the virtual bus. Errors: RecordingError, DeviceNotFound."""
        bus = self.bench(options, clock).bus
        return record_dialogue(bus, options.serial, clock, lock_name=_lock_name(options))


plugin = UsbMock()


def _lock_name(options: UsbMockOptions) -> str:
    """Two stations of one computer may play the same recording as two sensors."""
    own = f"-{options.serial}" if options.serial else ""
    return f"virtual-{options.recording.resolve()}{own}"[-200:]


def _board(header: RecordingHeader, serial: str | None) -> Board:
    """The recorded sensor's strings and its one video mode; another serial also changes the end of the product
    string."""
    mode = ((*header.mode, header.nominal_fps),)
    if serial is None:
        return Board(header.product, header.serial, mode)
    family = " ".join(header.product.split()[:-1])
    return Board(f"{family} {serial[:4]}-{serial[4:]}", serial, mode)


class _Payloads(Sequence[bytes]):
    """The frames of a recording as a camera with an MJPEG mode can send them; read from disk one at a time."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, position: int) -> bytes:  # type: ignore[override]  # frames are played one by one
        payload = self._recording[position].frame.payload
        return _as_jpeg(payload) if kind(payload) == "png" else payload


def _as_jpeg(png: bytes) -> bytes:
    import cv2
    import numpy as np

    bgr = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if bgr is None:
        raise FrameCorrupt(f"a PNG frame of {len(png)} bytes cannot be decoded")
    jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    text = comment(png)
    return jpeg if text is None else with_comment(jpeg, text)
