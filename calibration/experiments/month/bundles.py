"""The bundles of a month: the one of the first day, and what `gelgate bundle learn` makes of a day's answers."""

import contextlib
import io
import json
import logging
from pathlib import Path
from typing import Final

import cv2

from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import NOMINAL
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.learn_command import learn
from calibration.fitting.options import DEFAULT_METHOD
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.simulator.renderer import U8
from edge import registry
from edge.core.errors import GelgateError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.archive import MANIFEST

__all__ = ["fit_first", "learn_from_day"]

log = logging.getLogger(__name__)

# The evening before the first shift, by the month's own calendar.
_CREATED: Final = "2026-01-04"
_FREE: Final = 6
_PRESSES, _FREE_GEL = "nominal", "free gel"


def fit_first(gel: MountedGel, folder: Path) -> Path:
    """Take nominal presses, and fit them as `gelgate fit` does by default; return the bundle."""
    bundle = folder / "first"
    if bundle.is_dir():
        return bundle
    pieces, twice = NOMINAL
    for piece in range(pieces):
        for attempt in range(2 if piece < twice else 1):
            _write(
                folder / _PRESSES / f"RP_pos1_s{piece + 1:03d}_p{attempt + 1:02d}.png",
                gel.nominal(piece, attempt),
            )
    for number in range(_FREE):
        _write(folder / _FREE_GEL / f"{number}.png", gel.nominal_free(number))
    sensor, detector = profile("cropped_lr"), registry.detector(DEFAULT_METHOD)
    region = Region.centre(sensor.size)
    presses = read_presses([folder / _PRESSES], sensor, region, no_contact=[folder / _FREE_GEL])
    trunk = open_trunk(DEFAULT_BACKBONE, detector.taps(detector.parameters()))
    config = FitConfig(
        part=f"part {gel.month.part}",
        position="pos1",
        profile=sensor,
        region=region,
        detector=detector,
        trunk=trunk,
        threads=1,
        revision=1,
        register="auto",
        augment="auto",
    )
    return fit_files(presses, config, created=_CREATED).write(bundle)


def learn_from_day(bundle: Path, fit: Path, station: Path, new: Path, date: str) -> str | None:
    """Run `gelgate bundle learn` on what was said at a station; return why there is no new bundle, None where there is.

    fit: the folder of `fit_first`. station: that of the station, with its database. date: of the line's calendar, by
    which a station tells whether a bundle is older than its gel.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            learn(
                bundle=bundle,
                sources=[fit / _PRESSES],
                output=new,
                database=station / "gelgate.db",
                no_contact=[fit / _FREE_GEL],
                threads=1,
            )
    except GelgateError as error:
        return str(error)
    finally:
        log.debug("%s", said.getvalue())
    manifest = json.loads((new / MANIFEST).read_text(encoding="utf-8"))
    manifest["provenance"]["created"] = date
    (new / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
    return None


def _write(path: Path, rgb: U8) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
