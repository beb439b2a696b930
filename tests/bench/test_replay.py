"""Verdicts made again: how many are equal bit for bit, for bundles of several kinds, and what archiving costs."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TypeVar
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from registered_bundle import registered
from turned_parts import BLOCK, anywhere

from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.clock import SystemClock
from edge.core.arrays import U8
from edge.core.contact.mask import Touch
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.press import JudgedFrame
from edge.features.black_box.replay import judge_again
from edge.features.black_box.stage import BlackBox
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.press_archive import ArchivedPress, ArchiveFolder, PressArchive
from edge.store.ulid import new_ulid

PRESSES = 25
SIDE = 224
THREADS = 2

T = TypeVar("T")


@dataclass(frozen=True)
class Kind:
    """A bundle of this method and trunk."""

    method: str
    backbone: str = "tactile_resnet18"

    def bundle(self) -> Fitted:
        config = FitConfig(
            part="PZ0",
            position="pos1",
            profile=SensorProfile("square", (SIDE, SIDE), (0.0, 0.0), (SIDE, SIDE), 1, 15.77),
            region=Region(0, 0, SIDE, SIDE),
            detector=registry.detector(self.method),
            trunk=open_trunk(self.backbone),
            threads=THREADS,
        )
        names = tuple(f"press {n}" for n in range(20))
        return fit_files(NominalPresses(pictures(20, 0), names), config, created="2026-01-01")

    def frames(self) -> U8:
        return pictures(PRESSES, 1)


class AnyPose(Kind):
    """A bundle that registers its presses."""

    def bundle(self) -> Fitted:
        return registered()

    def frames(self) -> U8:
        return anywhere(BLOCK, PRESSES, 7)[1]


KINDS = {
    "padim": Kind("padim"),
    "padim, int8 trunk": Kind("padim", "tactile_resnet18_int8"),
    "spade": Kind("spade"),
    "patchcore": Kind("patchcore"),
    "registered": AnyPose("tiny"),
}


@pytest.mark.bench
@pytest.mark.parametrize("name", KINDS)
def test_verdicts_made_again(tmp_path: Path, name: str) -> None:
    """Prints how many of the archived presses are equal, by a session that is opened again, and the archive's cost."""
    kind = KINDS[name]
    bundle = kind.bundle().bundle()
    archive = PressArchive(tmp_path / "archive", 1000, 10**9)
    box = BlackBox(archive, Mock(), "site/line/station", THREADS, Mock())
    box.mount(Mock(serial="SIM1"))
    inspector = Inspector(Scorer(bundle, THREADS), SystemClock())
    free = np.full((120, 160, 3), 120, np.float32)
    archived: list[ArchivedPress] = []
    inspecting, archiving = [], []
    for rgb in kind.frames():
        frame = CameraFrame(jpeg(rgb), 0, 0, is_on_demand=True)
        inspection, ms = timed(lambda frame=frame: inspector.inspect(frame, Touch(0.2)))
        inspecting.append(ms)
        inspection = replace(inspection, judged=JudgedFrame(frame, Touch(0.2), free))
        named = replace(inspection, press_id=new_ulid(time.time_ns()), bundle_id=bundle.digest)
        press, ms = timed(lambda press=named: box.keep(press, inspector))
        archiving.append(ms)
        archived.append(ArchiveFolder(tmp_path / "archive").press(press.press_id, press.evidence))
    again = Inspector(Scorer(bundle, THREADS), SystemClock())
    equal = sum(judge_again(one, ArchiveFolder(tmp_path / "archive"), again).is_equal for one in archived)

    print(
        f"\n{name}: {equal} of {len(archived)} equal, bit for bit; archiving takes {median(archiving):.1f} ms, "
        f"{median(archiving) / median(inspecting):.0%} of an inspection"
    )


def timed(do: Callable[[], T]) -> tuple[T, float]:
    start = time.perf_counter()
    made = do()
    return made, (time.perf_counter() - start) * 1e3


def pictures(n: int, seed: int) -> U8:
    """Smooth random pictures, uint8 (n, h, w, 3): presses that differ a little."""
    rng = np.random.default_rng(seed)
    common = np.random.default_rng(9).integers(60, 200, (12, 16, 3)).astype(np.float32)
    each = common + rng.normal(0, 6, (n, 12, 16, 3)).astype(np.float32)
    large = [cv2.resize(one, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC) for one in each]
    return np.clip(np.stack(large) + rng.normal(0, 1.5, (n, SIDE, SIDE, 3)), 0, 255).astype(np.uint8)


def jpeg(rgb: U8) -> bytes:
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 95])[
        1
    ].tobytes()
