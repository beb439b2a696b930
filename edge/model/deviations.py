"""The deviations of a press in millimetres, against the good presses of its bundle.

It takes a tenth of a second of a core, so it is done when the result has left, as pictures are.
"""

import cv2
import numpy as np

from edge.core.arrays import F64, U8, Mask
from edge.core.contact.reference import View, fit_levels
from edge.core.defects import Defect, Measured
from edge.core.heights.calibration import SIZE, HeightCalibration
from edge.core.heights.deviation import measure_deviation
from edge.core.heights.height_map import free_picture, part_heights
from edge.core.imaging.known_profiles import PROFILES
from edge.core.press import Press
from edge.core.registration.pose import Registered
from edge.model.bundle import Bundle

__all__ = ["DeviationMeter"]


class DeviationMeter:
    """Measures presses of one calibrated gel; keeps the heights of the good presses of the newest bundle.

    Used by one thread at a time.
    """

    def __init__(self, calibration: HeightCalibration) -> None:
        self.calibration = calibration
        self._good: tuple[str, list[F64]] = ("", [])

    def measure(
        self, press: Press, defects: list[Defect], bundle: Bundle, serial: str | None = None
    ) -> Measured:
        """Measure these defects of a press with its pictures. serial: of the sensor."""
        free = press.judged.reference if press.judged else None
        reason = self._why_not(free, bundle, serial)
        if reason or free is None or press.rgb is None:
            return Measured(self.calibration.name, reason=reason)
        judged = bundle.region.height, bundle.region.width
        if bundle.digest != self._good[0]:
            ground, at_fit = np.asarray(bundle.free_region, np.float32), _view(bundle)
            self._good = bundle.digest, [self._heights(one, ground, at_fit, bundle) for one in _good(bundle)]
        whole = cv2.resize(free, bundle.profile.size, interpolation=cv2.INTER_CUBIC)
        heights = self._heights(
            bundle.prepare(press.rgb), bundle.region.crop(np.asarray(whole, np.float32)), free, bundle
        )
        size = heights.shape[1], heights.shape[0]
        good = [_lay(one, press.registered, bundle.region.width) for one in self._good[1]]
        above = [_places(defect, judged, size) for defect in defects]
        sound = ~np.logical_or.reduce(above) if above else np.ones(heights.shape, np.bool_)
        sound &= ~_resize(_unjudged(press, bundle), size)
        return Measured(
            self.calibration.name,
            tuple(measure_deviation(heights, good, places, sound, self.calibration) for places in above),
        )

    def _why_not(self, free: View | None, bundle: Bundle, serial: str | None) -> str:
        """Say why a press cannot be measured, empty where it can."""
        profile, camera = bundle.profile, PROFILES["mini_lr"]
        crops = [(one.native, one.border) for one in (camera, PROFILES["cropped_lr"])]
        if (profile.native, profile.border) not in crops:
            return (
                f"heights are calibrated in the maker's crop, and the bundle has the profile {profile.name}"
            )
        if bundle.manifest.dots is not None:
            return "marker dots hide slopes"
        if free is None:
            return "this press has no picture of the free gel"
        if bundle.free_view is None or not _good(bundle):
            return "the bundle has no good press with a free gel to compare with; fit it again"
        if reason := self.calibration.why_not(free_picture(free), serial):
            return reason
        if reason := self.calibration.why_not(free_picture(_view(bundle))):
            return f"the gel of the bundle's good presses: {reason}"
        return ""

    def _heights(self, rgb: U8, ground: View, free: View, bundle: Bundle) -> F64:
        """Return the heights of the inspected region, at the scale of the calibration. ground: the free gel there.
        free: all of it."""
        region, (width, height) = bundle.region, bundle.profile.size
        box = (
            region.x / width,
            region.y / height,
            (region.x + region.width) / width,
            (region.y + region.height) / height,
        )
        w, h = (2 * max(4, round(n * (b - a) / 2)) for n, a, b in zip(SIZE, box[:2], box[2:], strict=True))
        press, bare = (
            np.asarray(cv2.resize(picture, (w, h), interpolation=cv2.INTER_AREA), np.float32)
            for picture in (rgb.astype(np.float32), ground)
        )
        smooth = [np.asarray(cv2.GaussianBlur(one, (0, 0), 2.0), np.float32) for one in (press, bare)]
        change = fit_levels(*smooth).applied(press) - bare
        return part_heights(change, self.calibration, self.calibration.light(free_picture(free)), box)


def _view(bundle: Bundle) -> View:
    return np.asarray(bundle.free_view, np.float32)


def _good(bundle: Bundle) -> list[U8]:
    """Return good presses in the bank's pose: the golden frames that nothing is painted on."""
    return [press.rgb for press in bundle.golden if "painted" not in press.what]


def _lay(heights: F64, registered: Registered | None, width_px: int) -> F64:
    """Lay heights in the bank's pose where the part lies in the press, NaN where nothing is known. width_px: of the
    inspected region, in which poses are."""
    if registered is None:
        return heights
    h, w = heights.shape
    move = registered.pose.scale(w / width_px).inverse().matrix((w, h))
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(heights, move, (w, h), flags=how, borderValue=float("nan")), np.float64)


def _places(defect: Defect, judged: tuple[int, int], size: tuple[int, int]) -> Mask:
    """Return the places of a defect, bool (h, w) of this size (width, height). judged: (h, w) of the score map."""
    left, top, width, height = defect.box_px
    places = np.zeros(judged, np.bool_)
    places[top : top + height, left : left + width] = defect.inside
    return _resize(places, size)


def _resize(places: Mask, size: tuple[int, int]) -> Mask:
    """A place of the smaller picture is taken where any of the larger one's is."""
    return np.asarray(cv2.resize(places.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0)


def _unjudged(press: Press, bundle: Bundle) -> Mask:
    """Return the places of the region that are not judged: beyond the bank, under scars, in drawn regions."""
    unseen = [] if press.registered is None else [press.registered.unseen_in_press]
    masked = [] if press.scars is None or press.scars.masked is None else [press.scars.masked]
    blind = bundle.blind
    if blind is not None:
        masked.append(blind if press.registered is None else press.registered.mask_in_press(blind))
    return np.asarray(np.logical_or.reduce([np.zeros(bundle.manifest.frame, np.bool_), *unseen, *masked]))
