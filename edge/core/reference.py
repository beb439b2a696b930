"""The no-contact reference, and how a view differs from it once the exposure's drift is taken out.

The camera's level moves by a fifth within a session when exposure is automatic (measured on public recordings), so a
view is first brought to the reference's level by one gain and one offset per channel, fitted to pixels that the part
does not touch.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["Levels", "Reference", "View", "fit_levels"]

View = NDArray[np.float32]
"""float32 (h, w, 3), RGB, 0 to 255: see `edge.core.decode.decode_view`."""

# Every fourth row and column carries the fit: 1,200 pixels for six numbers.
_STRIDE = 4
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

    @classmethod
    def unchanged(cls) -> Self:
        return cls(np.ones(3, np.float32), np.zeros(3, np.float32))

    def applied(self, view: View) -> View:
        """The view at the reference's level: float32 (h, w, 3), not clipped."""
        return view * self.gain + self.offset


@dataclass(frozen=True)
class Reference:
    """The untouched gel: the mean of `frames` still views. view: float32 (h, w, 3), RGB, 0 to 255."""

    view: View
    frames: int
    learnt_ns: int

    def __post_init__(self) -> None:
        if self.view.ndim != 3 or self.view.shape[2] != 3 or self.view.dtype != np.float32:
            raise ValueError(f"a reference is float32 (h, w, 3), found {self.view.dtype} {self.view.shape}")
        if not np.isfinite(self.view).all() or self.frames < 1:
            raise ValueError(f"a reference is finite and the mean of at least one frame, found {self.frames}")

    def difference(self, view: View) -> View:
        """The view at this reference's level minus the reference: signed float32 (h, w, 3), levels."""
        return fit_levels(view, self.view).applied(view) - self.view

    def refreshed(self, view: View, weight: float, timestamp_ns: int) -> "Reference":
        """A new reference, moved towards a fresh mean view by `weight` (0 to 1)."""
        if not 0 <= weight <= 1:
            raise ValueError(f"the weight of a refresh lies in [0, 1], found {weight}")
        moved = self.view + np.float32(weight) * (view - self.view)
        return Reference(moved, self.frames + 1, timestamp_ns)


def fit_levels(view: View, reference: View) -> Levels:
    """Per-channel gain and offset that bring a view to a reference's level, blind to what the part touches.

    Trimmed least squares: each round drops the pixels whose residual, over all channels, is beyond 2.5 robust
    standard deviations. view, reference: float32 (h, w, 3).
    """
    x = view[::_STRIDE, ::_STRIDE].reshape(-1, 3).astype(np.float64)
    y = reference[::_STRIDE, ::_STRIDE].reshape(-1, 3).astype(np.float64)
    kept = np.ones(len(x), np.bool_)
    gain, offset = _start(x, y)
    for _ in range(_ROUNDS):
        residual = np.abs(x * gain + offset - y).max(axis=1)
        spread = _MAD_TO_SIGMA * float(np.median(residual[kept]))
        kept = residual <= _KEEP_SIGMAS * max(spread, _NOISE_FLOOR)
        if not kept.any():
            return Levels.unchanged()
        gain, offset = _line(x[kept], y[kept])
    return Levels(gain.astype(np.float32), offset.astype(np.float32))


def _start(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A gain per channel from the median ratio, which half the pixels cannot move."""
    ratio = np.median((y + 1.0) / (x + 1.0), axis=0)
    return np.clip(ratio, *GAIN_RANGE), np.zeros(3)


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least squares per channel. A picture without contrast gives no gain, so one level of prior holds it at 1."""
    mx, my = x.mean(axis=0), y.mean(axis=0)
    dx, dy = x - mx, y - my
    gain = ((dx * dy).mean(axis=0) + 1.0) / ((dx * dx).mean(axis=0) + 1.0)
    gain = np.clip(gain, *GAIN_RANGE)
    return gain, my - gain * mx
