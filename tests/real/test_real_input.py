"""The main job on real GelSight Mini frames: recorded, learnt, pressed on the virtual sensor, published.

One ball at many places is no fixtured part, so it is learnt by the method that is meant for that, and what is asked of
the verdicts is coarse; what is asked of the presses is exact: each is seen once, counted once and has its picture.
"""

import json
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from station import JSONL, station_config

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.self_check import scatter_warnings
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from edge import registry
from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import FitError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.gateway.build import open_station
from edge.gateway.recorder import PressReport
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.recording.from_images import PressLift, record_images
from edge.store.press_store import Store

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)
NOMINAL, TESTED = range(24), range(24, 30)
# A thread of another part, pressed on another unit of the sensor.
STRANGER = "RavenLiang1005__UniCal/GelSight"


@pytest.fixture(scope="module")
def unit(real_tactile: Path) -> Path:
    return real_tactile / "rpl-cmu__gelslam"


@pytest.fixture(scope="module")
def station(unit: Path, real_tactile: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A station's configuration: a bundle from 24 real presses; 6 others and a thread are in its recording. By
    InReaCh: methods that compare place with place pass the thread here, and a fit of theirs warns."""
    folder = tmp_path_factory.mktemp("real")
    detector = registry.detector("inreach")
    trunk = open_trunk(DEFAULT_BACKBONE, detector.taps(detector.parameters()))
    nominal = [unit / "6.310mm" / str(k) / "gelsight.png" for k in NOMINAL]
    presses = read_presses(nominal, PROFILE, REGION, no_contact=[unit / "background.png"])
    config = FitConfig("ball", "any", PROFILE, REGION, detector, trunk, folds=2, limit="plain")
    bundle = fit_files(presses, config, created="test").write(folder / "ball")
    tested = [unit / "6.310mm" / str(k) / "gelsight.png" for k in TESTED]
    plan = PressLift(lead_frames=20, free_frames=12, press_frames=10, noise_levels=1.5, noise_seed=1)
    record_images(
        folder / "presses",
        [*tested, _thread_on_this_unit(unit, real_tactile, folder / "thread.png")],
        unit / "background.png",
        plan,
        product="GelSight Mini R0B 2BNN-4ZE7",
        serial="2BNN4ZE7",
        profile=PROFILE.name,
    )
    return station_config(
        folder / "station", folder / "presses", bundle, sinks=JSONL % (folder / "station/out")
    )


def _thread_on_this_unit(unit: Path, real_tactile: Path, path: Path) -> Path:
    """The thread's imprint, as what it adds to its own picture's smooth light, on this unit's free gel."""
    thread = cv2.imread(str(sorted((real_tactile / STRANGER).glob("*.png"))[0]))
    free = cv2.imread(str(unit / "background.png"))
    assert thread is not None
    assert free is not None
    thread = cv2.resize(thread, PROFILE.size, interpolation=cv2.INTER_AREA).astype(np.float32)
    imprint = thread - cv2.GaussianBlur(thread, (0, 0), 25)
    cv2.imwrite(str(path), np.clip(free + imprint, 0, 255).astype(np.uint8))
    return path


@pytest.fixture(scope="module")
def reports(station: Path) -> list[PressReport]:
    found: list[PressReport] = []
    with open_station(load_config(station), SystemClock(), found.append) as gateway:
        gateway.run(threading.Event())
    return found


def test_a_fit_of_another_method_is_refused(unit: Path) -> None:
    """These presses are what the refusal is for."""
    nominal = [unit / "6.310mm" / str(k) / "gelsight.png" for k in NOMINAL]
    presses = read_presses(nominal, PROFILE, REGION, no_contact=[unit / "background.png"])
    for method in ("padim", "spade", "fapm"):
        with pytest.raises(FitError, match="hold the part at one place, or fit inreach"):
            scatter_warnings(presses, PROFILE, registry.detector(method))
    assert scatter_warnings(presses, PROFILE, registry.detector("inreach")) == []


def test_the_free_gel_is_what_balls_that_lie_anywhere_leave_free(unit: Path) -> None:
    """A level or two from the picture of it, in the median."""
    nominal = [unit / "6.310mm" / str(k) / "gelsight.png" for k in NOMINAL]
    presses, given = (
        read_presses(nominal, PROFILE, REGION, no_contact=free) for free in ([], [unit / "background.png"])
    )
    assert presses.facts["free_gel"].startswith(f"estimated from {len(nominal)} presses")
    assert presses.no_contact is not None
    assert given.no_contact is not None
    assert np.median(np.abs(presses.no_contact[0].astype(float) - given.no_contact[0])) < 2


def test_every_real_press_is_seen_and_counted_once(station: Path, reports: list[PressReport]) -> None:
    """Seven presses, seven results, seven on the gel, seven pictures."""
    presses = len(TESTED) + 1
    lines = [json.loads(line) for line in (station.parent / "out/messages.jsonl").read_text().splitlines()]
    with Store(station.parent / "gelgate.db") as store:
        (gel,) = store.gels()

    assert len(reports) == gel.presses == presses
    assert len({line["payload"]["press_id"] for line in lines if line["topic"] == "result"}) == presses
    assert len(list((station.parent / "out/heatmap").glob("*.jpg"))) == presses


def test_other_presses_of_the_ball_pass(reports: list[PressReport]) -> None:
    """Six presses at places that the bank may not have seen: at most two alarms."""
    verdicts = [report.result.verdict for report in reports[: len(TESTED)]]

    assert sum(verdict != "pass" for verdict in verdicts) <= 2


def test_the_thread_is_no_pass_and_scores_highest(reports: list[PressReport]) -> None:
    """Another part: refused by its score, or by where and how much it touches."""
    *balls, thread = (report.result for report in reports)

    assert thread.verdict in ("fail", "rejected")
    if thread.score is not None:
        assert thread.score > max(ball.score or 0.0 for ball in balls)


def test_a_mark_raises_the_map_where_it_is(station: Path, unit: Path) -> None:
    """A dark stroke drawn into a real free gel: the map's peak is on it, within the blur of the features."""
    scorer = Scorer(Bundle.load(station.parents[1] / "ball"))
    clean = read_presses([unit / "background.png"], PROFILE, REGION, resize=True).frames[0]
    marked = clean.copy()
    cv2.line(marked, (60, 150), (100, 180), (40, 40, 40), 4)
    risen = scorer.score(marked).score_map - scorer.score(clean).score_map
    row, column = np.unravel_index(int(risen.argmax()), risen.shape)

    assert 135 <= row <= 195
    assert 45 <= column <= 115
