"""A day at a station of the month, with the smallest detector: what is counted is what the station does."""

import shutil
from pathlib import Path

import cv2
import pytest
from shadow_station import FIVE
from station import variant
from tiny import TINY, tiny_trunk

from calibration.experiments.harness.rows import Rows
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month
from calibration.experiments.month.run import is_early, run_month
from calibration.experiments.month.station import DayStation, write_config
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import Trunk
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.session import TrunkSessions
from edge.store.database import open_read_only
from edge.store.person_verdicts import read_verdicts

MONTH = Month("development", 1, 8, days=2)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fitted on presses of the month's part; every press passes."""
    folder, gel = tmp_path_factory.mktemp("month"), MountedGel(MONTH)
    (folder / "nominal").mkdir()
    for piece in range(4):
        picture = cv2.cvtColor(gel.nominal(piece, 0), cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(folder / "nominal" / f"{piece}.png"), picture)
    sensor = profile("cropped_lr")
    region = Region.centre(sensor.size)
    config = FitConfig("part 1", "pos1", sensor, region, TINY, Trunk("tiny", tiny_trunk()), threshold=1e6)
    presses = read_presses([folder / "nominal"], sensor, region)
    return fit_files(presses, config, created="2026-01-04").write(folder / "bundle")


def test_a_day_counts_every_piece_and_keeps_every_answer(bundle: Path, tmp_path: Path) -> None:
    """All pass, so what is damaged or of another part escapes; the person's words are in the ledger, and all messages
    have left."""
    presses = MONTH.day(0)
    day = DayStation(write_config(tmp_path, bundle, 100), 0, MountedGel(MONTH), TrunkSessions(1))
    with day.open() as opened:
        opened.begin(presses[0], is_new_gel=False)
        for press in presses:
            opened.press(press)
        opened.end()

    counts = day.counts
    assert counts.pieces == len(presses) == 4
    assert (counts.false_alarms, counts.no_verdict) == (0, 0)
    assert counts.escapes == counts.not_sound == sum(press.truth != "sound" for press in presses)
    with open_read_only(tmp_path / "gelgate.db", "reading it") as connection:
        assert len(read_verdicts(connection)) == counts.asked == 4
        assert connection.execute("SELECT count(*) FROM outbox WHERE topic = 'result'").fetchone() == (0,)


def test_a_day_of_false_alarms_ends_with_the_wish_to_learn(bundle: Path, tmp_path: Path) -> None:
    """The person says that what failed was good, and the bundle had promised a twentieth."""
    promised = FIVE | {"alpha": 0.05, "alpha_floor": 0.05}
    wishes = []
    for name, value in (("lenient", 1e6), ("strict", 1e-9)):
        used = variant(bundle, tmp_path / name, threshold={**promised, "value": value})
        (tmp_path / f"station {name}").mkdir()
        config = write_config(tmp_path / f"station {name}", used, 100)
        day = DayStation(config, 0, MountedGel(MONTH), TrunkSessions(1))
        with day.open() as opened:
            opened.begin(MONTH.day(0)[0], is_new_gel=False)
            for press in MONTH.day(0):
                opened.press(press)
            opened.end()
        wishes.append(day.counts.must_learn)

    assert wishes == [False, True]


def test_another_gel_is_recorded_and_not_proven(bundle: Path, tmp_path: Path) -> None:
    """The bundle was used on the first one."""
    config = write_config(tmp_path, bundle, 100)
    for number, presses in enumerate((MONTH.day(0), MONTH.day(1))):
        day = DayStation(config, number, MountedGel(MONTH, number), TrunkSessions(1))
        with day.open() as opened:
            opened.begin(presses[0], is_new_gel=number == 1)
            opened.press(presses[0])
            opened.end()

    assert day.counts.unproven is not None
    assert "not yet proven on gel SIM00001-2" in day.counts.unproven
    assert day.counts.alarms["gel_proof"] == 1


@pytest.mark.parametrize(("least", "gels"), [(100, [2, 4]), (1, [2, 2, 2])], ids=["once a day", "worn"])
def test_a_gel_that_is_blamed_again_after_it_was_wiped_is_changed(
    least: int, gels: list[int], bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pieces are pressed again on the other gel, which is blamed as well; every press fails. least: presses before a
    gel of today is changed again."""
    monkeypatch.setattr("calibration.experiments.month.station._LEAST_PRESSES", least)
    strict = variant(bundle, tmp_path / "strict", threshold=FIVE | {"value": 1e-9})
    config, presses = write_config(tmp_path, strict, 100), MONTH.day(0)[:2]
    monkeypatch.setattr(
        DayStation, "_note_alarms", lambda day: setattr(day, "_raised", frozenset({"gel_scar"}))
    )
    with DayStation(config, 0, MountedGel(MONTH), TrunkSessions(1)).open() as opened:
        opened.begin(presses[0], is_new_gel=False)
        for press in presses:
            opened.press(press)
        opened.end()

    assert (opened.counts.wiped, opened.counts.pressed_again) == (5 - len(gels), 4)
    assert (opened.gel.number, opened.gel.since) == (len(gels) - 1, presses[len(gels) - 2].number)
    with open_read_only(tmp_path / "gelgate.db", "reading it") as connection:
        assert connection.execute("SELECT gel_id, count(*) FROM presses GROUP BY gel_id").fetchall() == [
            (f"SIM00001-{number + 1}", count) for number, count in enumerate(gels)
        ]


def test_a_shadow_of_too_few_presses_stays_a_shadow(bundle: Path, tmp_path: Path) -> None:
    """The station says how many are needed; a shadow that is worse is not kept."""
    other = variant(bundle, tmp_path / "other", revision=7)
    config = write_config(tmp_path, bundle, 100, shadow=other)
    with DayStation(config, 0, MountedGel(MONTH), TrunkSessions(1)).open() as opened:
        opened.begin(MONTH.day(0)[0], is_new_gel=False)
        opened.press(MONTH.day(0)[0])
        refusal = opened.adopt_shadow()

    assert refusal is not None
    assert "promises no rate of false alarms" in refusal
    assert "both have judged 1 press, at least 100 are needed" in refusal
    assert is_early(refusal)
    assert not is_early(f"{refusal}; it passes damage that was found: one")


class Interrupted(Exception):
    """Somebody stops the run."""


def test_an_interrupted_month_goes_on_with_the_day_that_it_was_in(bundle: Path, tmp_path: Path) -> None:
    """Its rows are those of a month that was not interrupted, whatever the broken day has left."""

    def prepare(folder: Path) -> Path:
        here = folder / "development-1-8-2"
        shutil.copytree(bundle, here / "fit" / "first")
        return here

    whole, broken = Rows(tmp_path / "whole.jsonl"), Rows(tmp_path / "broken.jsonl")
    prepare(tmp_path / "whole")
    run_month(MONTH, tmp_path / "whole", whole)

    def stop() -> None:
        raise Interrupted

    left = prepare(tmp_path / "broken")
    with pytest.raises(Interrupted):
        run_month(MONTH, tmp_path / "broken", broken, stop)
    (left / "frozen 1").mkdir()
    (left / "frozen 1" / "gelgate.db").write_bytes(b"a day that was not finished")
    run_month(MONTH, tmp_path / "broken", broken)

    def facts(rows: Rows) -> list[dict[str, object]]:
        names = {"cpu_s", "not_learnt"}  # the second says where nothing was found
        return [{name: row[name] for name in row if name not in names} for row in rows.read()]

    assert [(row["arm"], row["day"]) for row in facts(broken)] == [
        ("frozen", 1), ("frozen", 2), ("learning", 1), ("learning", 2)
    ]  # fmt: skip
    assert facts(broken) == facts(whole)
    assert not left.exists()
