"""The page of a month says what the rows say."""

from pathlib import Path
from typing import Any

import pytest
from command_line import gelgate

from calibration.experiments.harness.rows import Rows, read_rows
from calibration.experiments.month.page import page
from calibration.experiments.month.plan import DAYS, Month
from calibration.experiments.month.run import ARMS, NOT_ASKED, find_key

ROOT = Path(__file__).resolve().parents[3]


def row(arm: str, day: int, **changes: Any) -> dict[str, Any]:
    learnt = NOT_ASKED if arm == "frozen" else None
    return {
        "set": "development",
        "part": 0,
        "arm": arm,
        "day": day,
        "days": 5,
        "month_presses": 100,
        "gel": 0,
        "gel_since": 0,
        "pieces": 20,
        "sound": 19,
        "not_sound": 1,
        "escapes": 0,
        "false_alarms": 0,
        "unsure": 0,
        "no_verdict": 0,
        "pressed_again": 0,
        "wiped": 0,
        "asked": 10,
        "answered_wrongly": 0,
        "alarms": {},
        "escaped": {},
        "causes": {},
        "unproven": None,
        "promise": "some",
        "revision": 1,
        "not_learnt": learnt,
        "not_adopted": NOT_ASKED,
        "cpu_s": 60.0,
    } | changes


ROWS = [row(arm, day) for arm in ARMS for day in range(1, 6)]


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({}, "| days after the third with more than 2% false alarms | 0 of 2 | 0 of 2 |"),
        ({"false_alarms": 1}, "| days after the third with more than 2% false alarms | 0 of 2 | 1 of 2 |"),
        ({"escapes": 1}, "| escapes | 0 of 5 (0.0%; 0.0% to 36.9%) | 1 of 5 (20.0%; 2.1% to 58.4%) |"),
        ({"promise": None}, "| days whose bundle states no promise | 0 | 1 |"),
        ({"unproven": "another gel"}, "| days that end with a bundle not proven on the gel | 0 | 1 |"),
        (
            {"not_learnt": "refused"},
            "| nights with a new bundle, of those that it was asked for | 0 of 0 | 4 of 5 |",
        ),
    ],
)
def test_a_day_shows_in_the_totals(changes: dict[str, Any], line: str) -> None:
    """What changes on the last day of the learning station; spaces of the table apart."""
    rows = [*ROWS[:-1], ROWS[-1] | changes]

    text = " ".join(page(rows, "month.svg", "gelgate lab month").split())

    assert line in text


def test_the_page_of_the_manual_is_that_of_its_rows() -> None:
    """Nothing in it is typed."""
    rows = read_rows(ROOT / "docs/studies/month.jsonl")
    told = (ROOT / "docs/month.md").read_text(encoding="utf-8")
    command = told.partition("\n`")[2].partition("`")[0]

    assert page(rows, "images/month.svg", command) == told


def test_the_page_names_its_parts_and_what_they_took() -> None:
    """The command is the one that prints it."""
    text = page(ROWS, "month.svg", "gelgate lab month --presses 100")

    assert (
        "`gelgate lab month --presses 100`: development parts 0: 100 presses in 5 days each; 10 minutes"
        in text
    )


def test_rows_of_parts_that_ran_apart_give_one_page(tmp_path: Path) -> None:
    """Files of rows one after the other; nothing runs again."""
    lines = []
    for part in (2, 3):
        month = Month("development", part, 300)
        rows = Rows(tmp_path / f"{part}.jsonl")
        for arm in ARMS:
            for day in range(DAYS):
                facts = {"days": DAYS, "month_presses": 300, "part": part, "key": find_key(month, arm, day)}
                rows.append(row(arm, day + 1, **facts))
        lines.append(rows.path.read_bytes())
    (tmp_path / "all").mkdir()
    (tmp_path / "all" / "month.jsonl").write_bytes(b"".join(lines))

    ran = gelgate("lab", "month", "-o", tmp_path / "all", "--first", 2, "--parts", 2, "--presses", 300)

    assert ran.out.startswith(f"{4 * DAYS} days in")
    text = (tmp_path / "all" / "month.md").read_text()
    assert "--set development --first 2 --parts 2 --presses 300`: development parts 2, 3: 300 presses" in text


def test_a_part_that_is_not_touched_is_refused_before_the_first_day(tmp_path: Path) -> None:
    """Of all parts of the command: an hour of the part before it is not spent first."""
    ran = gelgate("lab", "month", "-o", tmp_path / "out", "--set", "judgement", "--first", 7, "--parts", 2)

    assert "part 8 of judgement cannot be taken: a press of 0.4 mm touches nothing" in ran.sentence()
    assert (ran.code, (tmp_path / "out").exists()) == (3, False)
