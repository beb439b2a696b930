"""Copies of a few nominal presses: the part put down and pressed again, shifted, turned, tilted, deeper, relit.

One press shows its part at one place. The next lies elsewhere by what a fixture or a hand allows, and a bank that
compares places finds that anomalous. What a press adds to the free gel is moved and scaled; the free gel stays. Colours
stay too: they turn with a part's slopes, but too little at these angles to show in a score. Noise is the press's own:
added noise makes a bank blind to small damage.

Ref: copies for one-shot banks, Damm et al., AnomalyDINO (2024), arXiv:2405.14529.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from edge.core.arrays import F32, U8
from edge.core.detector import Features, Mode, Nominal
from edge.core.errors import FitError
from edge.core.printable import write_count
from edge.core.registration.colours import FreeLight
from edge.core.registration.pose import Pose
from edge.model.manifest_facts import AUGMENTATION

__all__ = ["FEW", "Augment", "Augmentation", "Copies", "Take", "plan_copies", "render_copies"]

Take = Callable[[U8], Features]
"""The features of frames, uint8 (n, h, w, 3)."""

Augment = Literal["auto", "always", "never"]

FEW = 8
"""Up to this many presses `auto` adds copies. docs/detectors.md has the curve."""

# They compare a place with every other, and find no more with copies: there `auto` adds them for a threshold alone.
_NO_GAIN = frozenset({"patchcore", "subspace"})

EACH, MOST = 32, 64
"""Copies of a press, and of all together, which bounds the time of a fit."""

# Standard deviations: of a part that a hand puts into a loose fixture (calibration.simulator.parts), of gel and light.
_SHIFT_MM, _TURN_DEG, _DEPTH, _TILT, _GAIN = 0.4, 3.0, 0.08, 0.05, 0.02
_MOST_SD = 2.5


@dataclass(frozen=True)
class Augmentation:
    """How many copies of the presses a bank learns, and why."""

    each: int = 0
    """Copies of every press, 0 for none."""
    why: str = ""
    """A sentence for the manifest, empty for nothing to say."""

    @property
    def facts(self) -> dict[str, dict[str, Any]]:
        """The plan for the manifest."""
        return {AUGMENTATION: {"each": self.each, "why": self.why}} if self.why else {}


@dataclass(frozen=True, eq=False)
class Copies:
    """Features of copies, and which nominal press each is of, int64 (m,)."""

    features: Features
    press: NDArray[np.int64]

    @classmethod
    def of(
        cls, presses: NominalPresses, each: int, pixels_per_mm: float, seed: int, take: Take
    ) -> "Copies | None":
        """Render copies and take their features; None for no copies. take: the features of frames."""
        if not each:
            return None
        frames, press = render_copies(presses, each, pixels_per_mm, np.random.default_rng(seed))
        return cls(take(frames), press)

    def add_to(self, nominal: Nominal, presses: NDArray[np.int64]) -> Nominal:
        """Add the copies of these nominal presses alone. presses: which of the fit's presses those are, (n,)."""
        of = np.isin(self.press, presses)
        both = {tap: np.concatenate([maps, self.features[tap][of]]) for tap, maps in nominal.features.items()}
        return replace(nominal, features=both)


def plan_copies(
    augment: Augment, presses: NominalPresses, method: str, mode: Mode, is_registered: bool = False
) -> Augmentation:
    """Plan how many copies of each press a bank is learnt from. Errors: FitError where copies are asked for in vain."""
    n = len(presses)
    is_useful = mode != "paper" and n <= FEW and (n < MIN_PRESSES or method not in _NO_GAIN)
    if augment == "never" or not n or (augment == "auto" and not is_useful):
        return Augmentation()
    why = "the presses are registered, and lie in one pose already" if is_registered else ""
    if presses.no_contact is None or presses.estimated:
        why = "they need a picture of the free gel; give one with --no-contact, or a recording that shows it"
    if why and augment == "always":
        raise FitError(f"no copies of the presses can be added: {why}")
    if why:
        return Augmentation(0, f"no copies are added: {why}")
    each = max(1, min(EACH, MOST // n))
    of = "it" if n == 1 else "each"
    return Augmentation(
        each,
        f"the bank is of {write_count(n, 'press')} and {each} rendered cop{'y' if each == 1 else 'ies'} of {of}: "
        f"shifted by up to {_MOST_SD * _SHIFT_MM:.1f} mm, turned by up to {_MOST_SD * _TURN_DEG:.1f} degrees, tilted, "
        "and pressed deeper and lighter",
    )


def render_copies(
    presses: NominalPresses, each: int, pixels_per_mm: float, rng: np.random.Generator
) -> tuple[U8, NDArray[np.int64]]:
    """Render copies, uint8 (n * each, h, w, 3), and which press each is of, (n * each,). presses: with the free gel."""
    assert presses.no_contact is not None
    free = np.rint(presses.no_contact.mean(axis=0, dtype=np.float64)).astype(np.uint8)
    light = FreeLight(free)
    copies = [
        _copy(light, added, pixels_per_mm, rng)
        for added in (light.find_change(rgb) for rgb in presses.frames)
        for _ in range(each)
    ]
    return np.stack(copies), np.repeat(np.arange(len(presses)), each)


def _copy(light: FreeLight, added: F32, pixels_per_mm: float, rng: np.random.Generator) -> U8:
    """The press that adds this, float32 (h, w, 3), once more."""
    right, down, turn, depth, across, along, gain = np.clip(rng.standard_normal(7), -_MOST_SD, _MOST_SD)
    height, width = added.shape[:2]
    shift = _SHIFT_MM * pixels_per_mm
    pose = Pose(float(right) * shift, float(down) * shift, float(np.radians(turn * _TURN_DEG)))
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(
        added, pose.matrix((width, height)), (width, height), flags=flags, borderMode=cv2.BORDER_REFLECT
    )
    v, u = np.linspace(-1, 1, height)[:, None, None], np.linspace(-1, 1, width)[None, :, None]
    depths = 1 + _DEPTH * depth + _TILT * (across * u + along * v)
    picture = light.picture(np.asarray(moved * depths, np.float32))
    return np.asarray(np.clip(np.round(picture * (1 + _GAIN * gain)), 0, 255), np.uint8)
