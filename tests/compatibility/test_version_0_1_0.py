"""Files made by version 0.1.0 still load: a bundle with its scores, a recording with its presses, a database.

The bundle was fitted on twelve simulated presses with a region of 64x64 pixels; the database is what a station left
behind after twelve presses with a broker that was away.
"""

import shutil
from pathlib import Path

import pytest

from calibration.fitting.presses.nominal_presses import read_presses
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.backup import migrate
from edge.store.history import HistoryQuery, read_history
from edge.store.outbox import Outbox
from edge.store.press_store import Store

KEPT = Path(__file__).parent / "version_0_1_0"


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """A copy, migrated as a start of the gateway does it."""
    path = Path(shutil.copy(KEPT / "gelgate.db", tmp_path / "gelgate.db"))
    migrate(path)
    return path


def test_the_bundle_loads_and_gives_its_golden_scores() -> None:
    """The scores stored at fit are found again, within the tolerance stored with them."""
    bundle = Bundle.load(KEPT / "bundle")

    Scorer(bundle, threads=1).check_golden()
    assert (bundle.manifest.part, bundle.manifest.method) == ("PZ3", "padim")
    assert len(bundle.golden) == 3


def test_the_recording_gives_its_presses() -> None:
    """Two presses were recorded and two are found."""
    sensor = profile("cropped_lr")

    presses = read_presses([KEPT / "recording"], sensor, Region.centre(sensor.size))

    assert len(presses) == 2


def test_the_database_keeps_its_history_and_what_waits_in_it(database: Path) -> None:
    """Presses, the count of the gel, and the order of the presses; unsent messages wait for the sink of the same
    name."""
    with Store(database) as store, Outbox(database) as outbox:
        (gel,) = store.gels()
        verdicts = [press.verdict for press in read_history(database, HistoryQuery())]
        outbox.register(["mqtt", "jsonl"])
        waiting = [row.message.topic for row in outbox.pending("mqtt", limit=100)]

    assert (gel.gel_id, gel.presses, gel.limit_presses) == ("SIM00001-1", 12, 1000)
    assert (len(verdicts), verdicts.count("fail")) == (12, 5)
    assert (len(waiting), sum(topic.endswith("result") for topic in waiting)) == (19, 12)
