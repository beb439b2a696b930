"""Months day by day: two stations on the same plan, their bundles, and a row for each day of each."""

import contextlib
import io
import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2

from calibration.experiments.harness.rows import Rows
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import NOMINAL, Month
from calibration.experiments.month.station import DayStation, write_config
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.learn_command import learn
from calibration.fitting.options import DEFAULT_METHOD
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.simulator.reproducible_math import reproducible_opencv
from edge import registry
from edge.core.arrays import U8
from edge.core.errors import GelgateError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.archive import MANIFEST
from edge.model.bundle import Bundle
from edge.model.manifest_facts import promise
from edge.model.session import TrunkSessions

__all__ = ["ARMS", "NOT_ASKED", "PASSES_DAMAGE", "Row", "find_key", "fit_first", "is_early", "run_month"]

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
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
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
        log.debug("%s", output.getvalue())
    manifest = json.loads((new / MANIFEST).read_text(encoding="utf-8"))
    manifest["provenance"]["created"] = date
    (new / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
    return None


def _write(path: Path, rgb: U8) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))


ARMS: Final[Mapping[str, str]] = {
    "frozen": "the bundle of the first day, all month",
    "learning": (
        "`gelgate bundle learn` in each fifth night, and in each in which the station asks for it; its bundle is a "
        "shadow until it may take over"
    ),
}

NOT_ASKED: Final = "not asked"
"""Of a day without a shadow, and of a night without `gelgate bundle learn`."""

# What a station answers where a shadow has judged too few presses yet, and where it is worse.
TOO_FEW: Final = "both have judged"
PASSES_DAMAGE: Final = "it passes damage"
AGAIN: Final = "asks once more"
_WORSE: Final = (PASSES_DAMAGE, "do not pass it")

Row = Mapping[str, Any]

# Days between two nights in which a station learns, where no shadow waits: a fit takes as long as hundreds of presses.
_LEARN_EVERY: Final = 5

# Files of the archive never change, so a day's copy shares them.
_SHARED: Final = ".archive"


def find_key(month: Month, arm: str, day: int) -> str:
    """Return the key of a day's row."""
    return f"{month.which} {month.part} {month.presses} {month.days} {arm} {day}"


def run_month(month: Month, folder: Path, rows: Rows, advance: Callable[[], None] = lambda: None) -> None:
    """Run the days that have no row yet. folder: of stations and bundles, removed when all is done."""
    here = folder / f"{month.which}-{month.part}-{month.presses}-{month.days}"
    trunks = TrunkSessions(1)
    for arm in ARMS:
        yesterday: Row = {}
        for day in range(month.days):
            if find_key(month, arm, day) not in rows.done():
                with reproducible_opencv(), _silence_stations():
                    row = _run_day(month, arm, day, here, trunks, yesterday)
                rows.append(row)
                shutil.rmtree(here / f"{arm} {day - 1}", ignore_errors=True)
            yesterday = next(one for one in rows.read() if one["key"] == find_key(month, arm, day))
            advance()
    shutil.rmtree(here, ignore_errors=True)


def _run_day(month: Month, arm: str, day: int, here: Path, trunks: TrunkSessions, yesterday: Row) -> Row:
    """Run one day in a copy of the station's folder, so that a day that was interrupted begins again.

    yesterday: the row of the day before, nothing on the first.
    """
    began_s = time.process_time()
    presses, fit = month.day(day), here / "fit"
    is_new_gel = month.is_gel_changed(day)
    known = (yesterday.get("gel", 0), yesterday.get("gel_since", 0))
    gel = MountedGel(month, *((known[0] + 1, presses[0].number) if is_new_gel else known))
    first = fit_first(MountedGel(month), fit)
    station = _begin_folder(here, arm, day)
    learnt = here / "learnt"
    bundle = learnt / yesterday["next_bundle"] if yesterday.get("next_bundle") else first
    shadow = learnt / yesterday["next_shadow"] if yesterday.get("next_shadow") else None
    config = write_config(station, bundle, month.presses, month.questions, shadow)
    with DayStation(config, day, gel, trunks).open() as opened:
        opened.begin(presses[0], is_new_gel=is_new_gel)
        is_adopted = shadow is not None and opened.adopt_shadow() is None
        for press in presses:
            opened.press(press)
        opened.end()
        not_adopted = NOT_ASKED if shadow is None else None if is_adopted else opened.adopt_shadow()
    next_bundle, next_shadow = (bundle, shadow) if not_adopted is not None else (shadow or bundle, None)
    if not_adopted is not None and not is_early(not_adopted):
        next_shadow = None
    not_learnt: str | None = NOT_ASKED
    is_due = next_shadow is None and (day % _LEARN_EVERY == 0 or AGAIN in str(yesterday.get("not_learnt")))
    is_asked = opened.counts.must_learn or opened.counts.unproven is not None
    if arm == "learning" and (is_due or is_asked):
        new = learnt / f"night-{day:02d}"
        shutil.rmtree(new, ignore_errors=True)
        not_learnt = learn_from_day(next_bundle, fit, station, new, opened.date)
        next_shadow = new if not_learnt is None else next_shadow
    manifest, counts = Bundle.load(bundle).manifest, vars(opened.counts)
    return {
        "key": find_key(month, arm, day),
        "study": "month",
        "set": month.which,
        "part": month.part,
        "arm": arm,
        "day": day + 1,
        "days": month.days,
        "month_presses": month.presses,
        "gel": opened.gel.number,
        "gel_since": opened.gel.since,
        **counts,
        "alarms": dict(counts["alarms"]),
        "escaped": {name: number for name, number in counts["escaped"].items() if number},
        "causes": dict(counts["causes"]),
        "promise": promise(manifest.threshold) if manifest.threshold.n else None,
        "revision": manifest.revision,
        "not_adopted": not_adopted,
        "not_learnt": not_learnt and not_learnt.replace(f"{here}/", ""),  # rows name no folder of a machine
        "next_bundle": None if next_bundle == first else next_bundle.name,
        "next_shadow": None if next_shadow is None else next_shadow.name,
        "cpu_s": round(time.process_time() - began_s, 2),
    }


def _begin_folder(here: Path, arm: str, day: int) -> Path:
    """Return the folder of the station of a day: that of the day before as it ended, an empty one on the first."""
    before, station = here / f"{arm} {day - 1}", here / f"{arm} {day}"
    shutil.rmtree(station, ignore_errors=True)
    if day:
        shutil.copytree(before, station, copy_function=_copy)
    else:
        station.mkdir(parents=True)
    return station


def is_early(refusal: str) -> bool:
    """Tell whether a shadow has judged too few presses, and nothing else is against it: it stays a shadow."""
    return TOO_FEW in refusal and not any(word in refusal for word in _WORSE)


@contextmanager
def _silence_stations() -> Iterator[None]:
    """Keep the logs of stations away: their alarms are counted."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        yield
    finally:
        logging.disable(before)


def _copy(source: str, target: str) -> None:
    """Copy a file; link one of the archive."""
    if _SHARED in source:
        os.link(source, target)
    else:
        shutil.copy2(source, target)
