"""The overview camera of a running station: its newest still when a contact begins, which presses that admits and,
with `overview.select`, which bundle judges them."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from edge import registry
from edge.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.config import Config, OverviewTable
from edge.core.errors import ConfigError, DeviceError, FrameCorrupt, StoreError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import kind
from edge.core.overview.rules import OverviewRules
from edge.core.overview.view import OverviewView, Zone
from edge.core.part_position import PartPosition
from edge.core.ports import Clock
from edge.core.press import Press, PressLabel
from edge.core.sentence import Sentence
from edge.extras import needs
from edge.press_stage import Alarms, PressStage, Selection, StageParts
from edge.store.acts import select_part

__all__ = ["Overview", "read_rules", "say_overview_camera", "still_of"]

log = logging.getLogger(__name__)

# An overview camera may give one picture a second.
_STALL_S: Final = 5.0
# The loop waits this long for a still when the camera streams and none has come: less than the 0.8 s that the sensor's
# frames may wait.
WAIT_S: Final = 0.25
# The largest still that is decoded: twice the pixels of the largest sensor of an OAK.
MOST_PIXELS: Final = 100_000_000
JPEG_QUALITY: Final = 85


class Overview(PressStage):
    """Looks at each part before its press; master pieces and studies are not looked at. Its camera is read by a thread
    of its own.

    max_age_s: an older still says nothing of this press. max_side_px: larger stills are made smaller before they are
    read and published.
    """

    def __init__(
        self,
        camera: Acquisition,
        rules: OverviewRules,
        selection: Selection,
        clock: Clock,
        *,
        max_age_s: float,
        max_side_px: int,
    ) -> None:
        self.camera, self.rules, self._selection, self._clock = camera, rules, selection, clock
        self._max_age_s, self._max_side_px = max_age_s, max_side_px
        self._frame: CameraFrame | None = None
        self._grey: NDArray[np.uint8] | None = None
        self._view: OverviewView | None = None
        self._unselected: str | None = None

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        """Open the overview camera. Errors: ConfigError for a picture of the empty station that cannot be read."""
        table, clock = parts.config.overview, parts.clock
        if table is None:
            return None
        rules = read_rules(table)
        say_camera = partial(say_overview_camera, parts.alarms, is_needed=rules.is_asking)
        camera = Acquisition(
            table.opener(registry.overview(table.plugin), clock),
            clock,
            say_camera,
            depth=1,
            stall_after_s=_STALL_S,
        )
        return cls(
            camera,
            rules,
            parts.selection,
            clock,
            max_age_s=table.max_age_s,
            max_side_px=table.max_side_px,
        )

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        if config.overview is not None:
            yield "overview", partial(_find_camera, config.overview)

    def start(self) -> None:
        self.camera.start()

    def close(self) -> None:
        self.camera.close()

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        """Look at the part and select its bundle, before anything of this press is judged."""
        if label is None:
            self._view, self._unselected = self.look_at_part(), None
            part = (
                self.rules.choose_position(self._view, self._selection.find_all)
                if self.rules.select
                else None
            )
            if part is not None and part != self._selection.part:
                self._select(part, self._view)
        return label

    def _select(self, part: PartPosition, view: OverviewView) -> None:
        codes = {"codes": [code.text for code in view.codes]}
        why = select_part(self._clock.time_ns(), "the overview camera", codes, self._selection.part, part)
        try:
            self._selection.select(part, why, is_pressed=False)  # a press that just begins can still have it
        except StoreError as error:
            self._unselected = str(error)

    def admit(self, press: Press) -> Press:
        """Return it with what was seen when it began, and rejected where that refuses it."""
        if press.label is not None:
            return press
        view, self._view = self._view or self.look_at_part(), None
        refusal = self.rules.refusal(view, self._selection.part, self._selection.find_all)
        if refusal is not None and self._unselected is not None:
            refusal = replace(
                refusal, text=Sentence(f"{refusal.text}; it could not be selected: {self._unselected}")
            )
        self._unselected = None
        seen = replace(press, overview=view)
        return seen if refusal is None else seen.reject(refusal)

    def fields(self, press: Press) -> Mapping[str, Any]:
        view = press.overview
        if view is None:
            return {}
        return {
            "part_codes": [code.text for code in view.codes],
            "part_present": view.is_present,
            "overview_topic": f"overview/{press.press_id}" if view.jpeg else None,
        }

    def look_at_part(self) -> OverviewView:
        """Say what the newest still shows."""
        before, seen = self._frame, self._grey
        try:
            self._frame = self._newest()
            if self._frame is None:
                fault = self.camera.status.fault
                return OverviewView(
                    None, fault=fault or Sentence("the overview camera has given no new picture")
                )
            still, self._grey = still_of(self._frame, self._max_side_px)
            # The noise of a camera changes every picture: an equal one in a later frame is a camera that hangs.
            if self._frame is not before and seen is not None and np.array_equal(seen, self._grey):
                self._frame = None
                return OverviewView(
                    None, fault=Sentence("the overview camera gives one picture again and again")
                )
            return self.rules.look(still, self._grey)
        except DeviceError as error:  # a broken picture, or a recording that is over
            self._frame = None
            return OverviewView(None, fault=str(error))

    def _newest(self) -> CameraFrame | None:
        """The next frame of those made on demand, else the newest. Waits only for a camera that may soon give one."""
        waiting = self.camera.next(0)
        if waiting is None and self._frame is not None and not self._frame.is_on_demand:
            waiting = self._frame  # of an earlier press: the camera has given no newer one
        now_ns, longest_ns = self._clock.monotonic_ns(), self._max_age_s * 1e9
        if waiting is not None and (waiting.is_on_demand or now_ns - waiting.timestamp_ns <= longest_ns):
            return waiting
        if self.camera.status.state not in (AcquisitionState.CONNECTING, AcquisitionState.STREAMING):
            return None
        return self.camera.next(WAIT_S)


def _find_camera(table: OverviewTable) -> str:
    """A camera that is away is no fault: the station waits for it. Errors: ConfigError for its `empty`."""
    rules = read_rules(table)
    plugin = registry.overview(table.plugin)
    try:
        discovered = plugin.discover(plugin.Options.model_validate(table.options))
    except DeviceError as error:
        discovered, away = [], str(error)
    else:
        away = "; ".join(camera.refusal for camera in discovered if camera.refusal) or "no camera is found"
    names = [
        f"{camera.identity.product}, serial {camera.identity.serial}"
        for camera in discovered
        if camera.identity
    ]
    until = Sentence("presses are refused") if rules.is_asking else Sentence("results come without its still")
    return ", ".join(names) or f"{away}; until it comes {until}"


def read_rules(table: OverviewTable) -> OverviewRules:
    """Read what a still must show.

    Errors: ConfigError for a picture of the empty station that cannot be read, and for a kind of code whose reader
    is not installed.
    """
    if "datamatrix" in table.codes:
        needs("datamatrix", "overview.codes with datamatrix")
    empty = None
    if table.empty is not None:
        raw = cv2.imread(str(table.empty), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if raw is None:
            raise ConfigError(
                f"overview.empty: {table.empty} is no picture that can be read; save a still of the empty station"
            )
        empty = np.asarray(raw, np.uint8)
    return OverviewRules(
        codes=table.codes,
        family=table.apriltag_family,
        pattern=None if table.part_pattern is None else re.compile(table.part_pattern),
        parts=table.parts,
        select=table.select,
        zone=Zone(*table.region),
        empty=empty,
        present_share=table.present_share,
    )


def say_overview_camera(alarms: Alarms, camera: AcquisitionStatus, *, is_needed: bool) -> None:
    """Raise or clear the alarm of the overview camera. is_needed: without it presses are refused."""
    if camera.state is AcquisitionState.STREAMING:
        log.info("overview camera %s delivers pictures", camera.identity.serial if camera.identity else "?")
        alarms.say("overview", None)
        return
    is_over = camera.state is AcquisitionState.ENDED
    fault = Sentence("the recording of the overview camera is over") if is_over else camera.fault
    if fault is not None:
        effect = Sentence("presses are refused") if is_needed else Sentence("results come without its still")
        severity: Literal["warning", "error"] = "error" if is_needed else "warning"
        alarms.say("overview", Sentence(f"{fault}; until it is back {effect}"), severity)


def still_of(frame: CameraFrame, max_side_px: int) -> tuple[bytes, NDArray[np.uint8]]:
    """The JPEG to publish, and the same in grey, uint8 (h, w). A JPEG that is small enough is published untouched.

    Errors: FrameCorrupt for a picture that cannot be read.
    """
    size = frame.size
    if frame.damage is not None or size is None:
        raise FrameCorrupt(f"the overview camera's frame {frame.sequence} is {frame.damage or 'no picture'}")
    if size[0] * size[1] > MOST_PIXELS:
        raise FrameCorrupt(
            f"the overview camera's frame {frame.sequence} has {size[0]}x{size[1]} pixels, at most {MOST_PIXELS} are "
            "read; choose a smaller mode"
        )
    if kind(frame.payload) == "jpg" and max(size) <= max_side_px:
        return frame.payload, _decode(frame, cv2.IMREAD_GRAYSCALE)
    colour = _decode(frame, cv2.IMREAD_COLOR)
    scale = min(1.0, max_side_px / max(size))
    small = cv2.resize(colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return jpeg, np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _decode(frame: CameraFrame, flags: int) -> Any:
    """Decode a still. Errors: FrameCorrupt."""
    picture = cv2.imdecode(np.frombuffer(frame.payload, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        raise FrameCorrupt(f"the overview camera's frame {frame.sequence} cannot be decoded")
    return picture
