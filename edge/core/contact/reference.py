"""The no-contact reference, and how a view differs from it after the exposure's drift is removed.

The camera's level moves by a fifth within a session when exposure is automatic (measured on public recordings), so a
view is first brought to the reference's level by one gain and one offset per channel, fitted to pixels that the part
does not touch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Levels", "Reference", "View", "fit_levels"]

View = NDArray[np.float32]
"""float32 (h, w, 3), RGB, 0 to 255: see `edge.core.imaging.decode.decode_view`."""

_Pixels = NDArray[np.float64]

# Every fourth row and column carries the fit: 1,200 pixels for six numbers.
_STRIDE = 4
# The share of the view that is taken to be free when the fit begins.
_FREE_SHARE = 0.25
# Each round keeps the pixels within this many robust standard deviations of the last fit, so that the part, which is
# far off on one side, loses its pull. Four rounds bring a contact over 40 % of the view below one level of bias.
_ROUNDS = 4
_KEEP_SIGMAS = 2.5
# A residual this small is sensor noise and no reason to drop a pixel: sd 1.1 to 3.0 at 320x240 on four real units.
_NOISE_FLOOR = 1.5
# Median absolute deviation to standard deviation of a normal distribution.
_MAD_TO_SIGMA = 1.4826
# Automatic exposure moved the level by 20 %; twice that and more is another light, which no gain should hide.
GAIN_RANGE = (0.5, 2.0)


@dataclass(frozen=True)
class Levels:
    """How a view's level relates to the reference's: reference = gain * view + offset, float32 (3,) each, RGB."""

    gain: NDArray[np.float32]
    offset: NDArray[np.float32]

    def applied(self, view: View) -> View:
        """The view at the reference's level: float32 (h, w, 3), not clipped."""
        height, width, _ = view.shape
        # Complete rows at once: NumPy's loop over three colours alone is five times slower.
        rows = view.reshape(height, -1) * np.tile(self.gain, width) + np.tile(self.offset, width)
        return rows.reshape(view.shape)


@dataclass(frozen=True)
class Reference:
    """The untouched gel: the mean of still views."""

    view: View
    """float32 (h, w, 3), RGB, 0 to 255."""

    def __post_init__(self) -> None:
        if self.view.ndim != 3 or self.view.shape[2] != 3 or self.view.dtype != np.float32:
            raise ValueError(f"a reference is float32 (h, w, 3), found {self.view.dtype} {self.view.shape}")
        if not np.isfinite(self.view).all():
            raise ValueError("a reference is finite, found NaN or infinity")

    def difference(self, view: View) -> View:
        """The view at this reference's level minus the reference: signed float32 (h, w, 3), levels."""
        return fit_levels(view, self.view).applied(view) - self.view

    def refresh(self, view: View, weight: float) -> "Reference":
        """A new reference, moved towards a fresh mean view by `weight` (0 to 1)."""
        if not 0 <= weight <= 1:
            raise ValueError(f"the weight of a refresh lies in [0, 1], found {weight}")
        moved = self.view + np.float32(weight) * (view - self.view)
        return Reference(moved)


def fit_levels(view: View, reference: View) -> Levels:
    """Per-channel gain and offset that bring a view to a reference's level, without the touched pixels.

    Trimmed least squares: each round drops the pixels whose residual, over all channels, is beyond 2.5 robust
    standard deviations. view, reference: float32 (h, w, 3).
    """
    x, y = _sample(view), _sample(reference)
    residual = min((_residual(x, y, *start) for start in _starts(x, y)), key=_typical)
    kept = residual <= _KEEP_SIGMAS * max(_MAD_TO_SIGMA * _typical(residual), _NOISE_FLOOR)
    moments = np.concatenate([x, y, x * x, x * y])
    gain, offset = _line(moments, kept)
    for _ in range(_ROUNDS):
        residual = _residual(x, y, gain, offset)
        spread = _MAD_TO_SIGMA * _ranked(residual[kept], 0.5)
        now_kept = residual <= _KEEP_SIGMAS * max(spread, _NOISE_FLOOR)
        if not now_kept.any() or np.array_equal(now_kept, kept):
            break  # with the same pixels every further round gives the same line
        kept = now_kept
        gain, offset = _line(moments, kept)
    return Levels(gain[:, 0].astype(np.float32), offset[:, 0].astype(np.float32))


def _sample(view: View) -> _Pixels:
    """Some of the pixels: float64 (3, n), a channel in one piece so that sums over it are fast."""
    return np.ascontiguousarray(view[::_STRIDE, ::_STRIDE].reshape(-1, 3).T, dtype=np.float64)


def _residual(x: _Pixels, y: _Pixels, gain: _Pixels, offset: _Pixels) -> _Pixels:
    """The largest difference over the channels, float64 (n,)."""
    return np.asarray(np.abs(x * gain + offset - y).max(axis=0))


def _typical(residual: _Pixels) -> float:
    """The residual that the best quarter of the pixels stays below: a part may cover the other three."""
    return _ranked(residual, _FREE_SHARE)


def _ranked(values: _Pixels, share: float) -> float:
    """The value that `share` of the values do not exceed; np.quantile is ten times slower on so few."""
    rank = int(share * (len(values) - 1))
    return float(np.partition(values, rank)[rank])


def _starts(x: _Pixels, y: _Pixels) -> list[tuple[_Pixels, _Pixels]]:
    """Two first guesses: nothing has changed, and a gain per channel from the median ratio."""
    ratio = np.array([[_ranked(channel, 0.5)] for channel in (y + 1.0) / (x + 1.0)])
    none = np.zeros((3, 1))
    return [(none + 1.0, none), (np.clip(ratio, *GAIN_RANGE), none)]


def _line(moments: _Pixels, kept: NDArray[np.bool_]) -> tuple[_Pixels, _Pixels]:
    """Least squares per channel over the kept pixels: gain and offset, (3, 1) each.

    moments: x, y, x * x and x * y of every pixel, (12, n), so that one product with the kept ones gives all means. A
    picture without contrast gives no gain, so one level of prior holds it at 1.
    """
    means = moments @ kept.astype(np.float64) / np.count_nonzero(kept)
    mx, my, mxx, mxy = means.reshape(4, 3, 1)
    gain = np.clip((mxy - mx * my + 1.0) / (mxx - mx * mx + 1.0), *GAIN_RANGE)
    return gain, my - gain * mx
