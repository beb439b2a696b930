"""Presses one by one: from pictures, from recordings, and from the frames of a sensor that is running."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.dataset.files import read_rgb
from calibration.fitting.presses.nominal_presses import (
    is_recording,
    require_light,
    specimen_of,
    why_unread,
)
from calibration.fitting.presses.recorded_presses import FoundPress, PressFinder
from calibration.fitting.presses.sources import list_pictures
from edge import registry
from edge.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.cli.arguments import plugin_options
from edge.config import load_config
from edge.core.arrays import U8, Mask
from edge.core.contact.settings import ContactSettings
from edge.core.errors import DatasetError, FitError, FrameCorrupt, RecordingEnded
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.ports import Clock, Device
from edge.gateway.opening import device_opener
from edge.recording.format import Recording

__all__ = ["Found", "Sensor", "find_sensor", "frames_of", "from_frames", "from_sources"]


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of a press, or of the free gel."""

    name: str
    """Where it is from."""
    payload: bytes
    """The picture's file."""
    rgb: U8
    """uint8 (h, w, 3) in the profile's size."""
    piece: str | None = None
    """The piece; None where unknown."""
    mask: Mask | None = None
    """Where it touches in the contact view, bool (120, 160), None where the free gel is not known."""
    is_free: bool = False
    """Whether it is the gel without contact."""


Found = Shown | str
"""What a source gives next; a text says why a press cannot be used."""


def from_sources(
    sources: Sequence[Path],
    profile: SensorProfile,
    specimens: Mapping[Path, str | None],
    *,
    no_contact: Sequence[Path] = (),
    resize: bool = False,
    pattern: str | None = None,
) -> Iterator[Found]:
    """The free gel first, then the presses of recordings, then those of pictures in the order of their names.

    specimens: of pictures, where their names do not have it. Errors: RecordingError, FitError, DatasetError for the
    free gel.
    """
    free = list_pictures(no_contact)
    for path in free:
        rgb = require_light(path, read_rgb(path, profile, resize=resize))
        yield Shown(path.name, path.read_bytes(), rgb, is_free=True)
    for source in sources:
        if is_recording(source):
            recording, finder = Recording.open(source), PressFinder(profile)
            frames = ((recorded.frame, (recorded.label or {}).get("specimen")) for recorded in recording)
            yield from from_frames(frames, finder, profile, source.name)
            if finder.detector.newest is None:
                raise FitError(f"no press was found: {why_unread(source, finder.detector)}")
    pictures = [source for source in sources if not is_recording(source)]
    for path in list_pictures(pictures, pattern):
        if not any(path.samefile(frame) for frame in free):
            yield _of_picture(path, specimens.get(path) or specimen_of(path), profile, resize)


def _of_picture(path: Path, piece: str | None, profile: SensorProfile, resize: bool) -> Found:
    try:
        rgb = require_light(path, read_rgb(path, profile, resize=resize))
    except DatasetError as error:
        return str(error)
    return Shown(f"{path.parent.name}/{path.name}", path.read_bytes(), rgb, piece)


def from_frames(
    frames: Iterable[tuple[CameraFrame, object]], finder: PressFinder, profile: SensorProfile, name: str
) -> Iterator[Found]:
    """The presses of one sensor's frames, each with its piece or None. name: of the recording, or of the sensor."""
    pieces: dict[int, object] = {}
    for frame, piece in frames:
        pieces[frame.sequence] = piece
        for press_or_free in finder.feed(frame):
            shown = press_or_free.frame if isinstance(press_or_free, FoundPress) else press_or_free
            where = f"{name}#{shown.sequence}"
            try:
                rgb = decode(shown, profile)
            except FrameCorrupt as error:
                yield f"press {where} cannot be read: {error}"
                continue
            if not isinstance(press_or_free, FoundPress):
                yield Shown(where, shown.payload, rgb, is_free=True)
                continue
            known = pieces.get(shown.sequence)
            yield Shown(where, shown.payload, rgb, None if known is None else str(known), press_or_free.mask)
            pieces = {key: kept for key, kept in pieces.items() if key > shown.sequence}


WAIT_S = 0.2


@dataclass(frozen=True)
class Sensor:
    """Where frames come from."""

    open: Callable[[], Device]
    contact: ContactSettings
    gel_limit: int
    """Presses that its gel is rated for."""


def find_sensor(
    config: Path | None, device: str, options: Sequence[str], profile: SensorProfile, clock: Clock
) -> Sensor:
    """Return the sensor of a station, whose bundle is not needed, or a device plugin. Errors: ConfigError."""
    if config is not None:
        loaded = load_config(config)
        return Sensor(
            device_opener(loaded.device, profile.controls, clock),
            loaded.contact.settings(is_external=False),
            loaded.gel.limit_presses,
        )
    plugin = registry.device(device)
    checked = plugin_options("devices", device, plugin.Options, options)
    return Sensor(lambda: plugin.open(checked, clock), ContactSettings(), DEFAULT_LIMIT_PRESSES)


def frames_of(sensor: Sensor, clock: Clock, say: Callable[[str], None]) -> Iterator[CameraFrame]:
    """Every frame, until a recording that is played ends. A sensor that goes away is waited for, and said.

    Errors: DeviceError where it cannot be opened at the start.
    """
    first: list[Device] = [sensor.open()]

    def open_first() -> Device:
        return first.pop() if first else sensor.open()

    def say_change(status: AcquisitionStatus) -> None:
        if status.state is AcquisitionState.FAULT:
            say(f"the sensor is away, waiting for it: {status.fault}")
        elif status.state is AcquisitionState.STREAMING and status.reconnects:
            say("the sensor is back")

    try:
        with Acquisition(open_first, clock, say_change) as acquisition:
            while True:
                frame = acquisition.next(WAIT_S)
                if frame is not None:
                    yield frame
    except RecordingEnded:
        return
    finally:
        for device in first:  # it was never taken
            device.close()
