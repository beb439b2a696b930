"""`gelgate history`: what a person asks, and what is printed."""

import json
from pathlib import Path

import pytest
from command_line import gelgate

from edge.cli.history import moment_ns
from edge.core.errors import ConfigError
from edge.store.acts import Act
from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid

T0 = 1_780_000_000 * 10**9  # 2026-05-28T20:26:40 UTC
HOUR_NS = 3600 * 10**9


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """25 presses, an hour apart; every fifth one fails."""
    path = tmp_path / "gelgate.db"
    with Store(path) as store:
        for n in range(25):
            time_ns, verdict = T0 + n * HOUR_NS, "fail" if n % 5 == 4 else "pass"
            press = PressRecord(
                new_ulid(time_ns), time_ns, "2BNN4ZE7", "bolt", verdict, score=0.5, threshold=1.0
            )
            store.record_press(press, lambda recorded: [])
    return path


@pytest.mark.usefixtures("tokyo")
def test_the_newest_presses_are_printed_with_their_totals(database: Path) -> None:
    """Twenty, oldest first, at local times with their offset, and a last line that counts all that fit: a fail among
    the earlier ones is not hidden. With --count it counts those."""
    done = gelgate("history", "--database", database)
    lines = done.out.splitlines()

    assert done.code == 0
    assert len(lines) == 21
    assert lines[0] == "6  2026-05-29 10:26:40+09:00  bolt/-  pass  0.5000 / 1.0000  gel 2BNN4ZE7-1"
    assert lines[-1] == "25 presses: 5 fail, 20 pass; the newest 20 are listed"
    counted = gelgate("history", "--database", database, "--count", "3").out.splitlines()
    assert counted[-1] == "3 presses: 1 fail, 2 pass"
    assert gelgate("history", "--database", database, "--verdict", "fail").out.endswith("5 presses: 5 fail\n")


def test_lines_for_a_program_say_what_they_leave_out(database: Path) -> None:
    """On stderr, for a program reads what is printed. Nothing is left out where a number is asked for, or all fit."""
    done = gelgate("history", "--database", database, "--json")
    assert len(done.out.splitlines()) == 20
    assert done.err == "gelgate: hint: the newest 20 of 25 presses; --count gives more\n"
    for given in (("--count", "25"), ("--verdict", "fail")):
        assert gelgate("history", "--database", database, "--json", *given).err == ""


def test_a_measured_deviation_is_printed(database: Path) -> None:
    """With its uncertainty, as on the picture of its press; what is not told is left out."""
    with Store(database) as store:
        measured = "UPDATE presses SET depth_mm = 0.249, depth_u95_mm = 0.179 WHERE number = 25"
        store.write("measuring a press", lambda connection: connection.execute(measured))
    line = gelgate("history", "--database", database).out.splitlines()[-2]
    assert line.startswith("25  ")
    assert line.endswith("  gel 2BNN4ZE7-1  depth 0.249 +- 0.179 mm")


def test_a_fail_of_part_or_gel_is_no_unsure_press(database: Path) -> None:
    """It has failed; what is not clear is its cause."""
    with Store(database) as store:
        blamed = "UPDATE presses SET verdict = 'fail', cause = 'unsure' WHERE number = 25"
        store.write("blaming", lambda connection: connection.execute(blamed))
    assert "  fail (part or gel)  " in gelgate("history", "--database", database).out.splitlines()[-2]


def test_a_file_has_all_that_fit(database: Path, tmp_path: Path) -> None:
    done = gelgate("history", "--database", database, "-o", tmp_path / "all.csv")

    assert done.out == f"25 presses in {tmp_path / 'all.csv'}\n"
    assert len((tmp_path / "all.csv").read_text().splitlines()) == 26


@pytest.mark.usefixtures("tokyo")
def test_conditions_are_combined(database: Path) -> None:
    """Fails from one moment up to another, as JSON lines; the moments are local."""
    done = gelgate(
        *("history", "--database", database, "--json", "--verdict", "fail", "--verdict", "unsure"),
        *("--since", "2026-05-29T15:00", "--until", "2026-05-30T05:00"),
    )

    assert [json.loads(line)["number"] for line in done.out.splitlines()] == [15, 20]


def test_a_mistyped_verdict_is_refused(database: Path) -> None:
    """An empty answer would look like a day without fails."""
    done = gelgate("history", "--database", database, "--verdict", "failed")

    assert done.code == 3
    assert done.sentence() == "no press has the verdict 'failed'; did you mean 'fail'?"


def test_an_end_before_the_beginning_is_refused(database: Path) -> None:
    """As an empty answer it would look like a day without fails."""
    done = gelgate("history", "--database", database, "--since", "2026-05-30", "--until", "2026-05-29")
    assert done.code == 3
    assert done.sentence() == "--since 2026-05-30 is not before --until 2026-05-29: no press can fit"


def test_of_a_mistyped_part_the_known_ones_are_named(database: Path) -> None:
    """As of a verdict: no fail of it would look good."""
    said = gelgate("history", "--database", database, "--part", "Bolt", "--verdict", "fail").out
    assert said == "no press fits; there are presses of bolt/-\n"


@pytest.mark.usefixtures("tokyo")
def test_acts_are_read_from_the_same_file(database: Path) -> None:
    """A station's database is not next to its configuration where a service runs it. An act that makes something has
    no before, and what it made is there."""
    with Store(database) as store:
        store.begin_act(Act(T0, "shift leader", "trigger", outcome="done"))
        made = Act(T0, "the gateway", "snapshot", outcome="done", after={"frames": 175})
        store.begin_act(made)

    when = "2026-05-29 05:26:40+09:00"
    lines = f"{when}  snapshot  done  for the gateway  frames: 175\n{when}  trigger  done  for shift leader\n"
    assert gelgate("station", "acts", "--database", database).out == lines


@pytest.mark.usefixtures("tokyo")
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-05-29", T0 - 19_600 * 10**9),
        ("2026-05-29T05:26:40", T0),
        ("2026-05-28T22:26:40+02:00", T0),
        ("2026-05-28T20:26:40Z", T0),
        ("2h", T0 - 2 * HOUR_NS),
        ("1d", T0 - 24 * HOUR_NS),
        ("9999-12-31", 2**63 - 1),
        ("1600-01-01", -(2**63)),
    ],
)
def test_a_moment_is_a_date_a_time_or_an_age(text: str, expected: int) -> None:
    """Local where no zone is named, as times are printed; one that no press can have is the first or last of all."""
    assert moment_ns(text, T0) == expected


@pytest.mark.parametrize("text", ["yesterday", "2026-13-01", "0001-01-01", "-3h", ""])
def test_what_is_no_moment_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="is no moment; give a date"):
        moment_ns(text, T0)
