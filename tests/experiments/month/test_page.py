"""The page of a month says what the rows say."""

from pathlib import Path

from command_line import gelgate

from calibration.experiments.harness.rows import Rows, read_rows
from calibration.experiments.month.page import page
from calibration.experiments.month.plan import DAYS, Month
from calibration.experiments.month.run import ARMS, find_key

ROOT = Path(__file__).resolve().parents[3]


def test_the_page_of_the_manual_is_that_of_its_rows() -> None:
    """Nothing in it is typed."""
    rows = read_rows(ROOT / "docs/studies/month.jsonl")
    told = (ROOT / "docs/month.md").read_text(encoding="utf-8")
    command = told.partition("\n`")[2].partition("`")[0]

    assert page(rows, "images/month.svg", command) == told


def test_rows_of_parts_that_ran_apart_give_one_page(tmp_path: Path) -> None:
    """Files of rows one after the other; nothing runs again."""
    lived = {(row["arm"], row["day"]): row for row in read_rows(ROOT / "docs/studies/month.jsonl")}
    lines = []
    for part in (2, 3):
        month = Month("development", part, 300)
        rows = Rows(tmp_path / f"{part}.jsonl")
        for arm in ARMS:
            for day in range(DAYS):
                facts = {"set": "development", "part": part, "days": DAYS, "month_presses": 300}
                rows.append(lived[arm, day + 1] | facts | {"key": find_key(month, arm, day)})
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
