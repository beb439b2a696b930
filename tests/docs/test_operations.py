"""docs/operations.md: every alarm of the program has its row, and what the page says of limits is the program's."""

import re
from pathlib import Path

import pytest

from edge.config.tables import GelTable
from edge.core.binomial import trials_needed
from edge.core.gel_proof import PROVEN_RATE
from edge.messaging.alarm_payload import ALARMS
from edge.store.acts import KEPT_ACTS, KEPT_REFUSALS
from edge.store.database import JOURNAL_LIMIT_BYTES
from edge.store.gel_files import KEPT_GELS
from edge.store.press_store import KEPT_PRESSES

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "operations.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def rows(title: str) -> list[list[str]]:
    """The cells of a section's table, without its head."""
    lines = [line for line in section(title).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_every_alarm_has_its_row_with_what_the_page_at_the_station_says() -> None:
    """In the order of the program; the last cell is what to do, links as their words."""
    said = [(row[0].strip("`"), re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", row[2])) for row in rows("Alarms")]

    assert said == [(alarm, kind.what_to_do) for alarm, kind in ALARMS.items()]


@pytest.mark.parametrize(
    ("page", "words"),
    [
        ("operations.md", f"the newest {KEPT_PRESSES:,}"),
        ("operations.md", f"the newest {KEPT_ACTS:,}, and {KEPT_REFUSALS:,} refusals"),
        ("operations.md", f"the newest {KEPT_GELS} gels"),
        ("operations.md", f"{JOURNAL_LIMIT_BYTES >> 20} MiB"),
        *(("gel.md", f"| {alarms} | {trials_needed(PROVEN_RATE, alarms)} |") for alarms in range(3)),
        ("gel.md", f"| `{GelTable().unproven}`, the default |"),
    ],
)
def test_the_limits_are_those_of_the_program(page: str, words: str) -> None:
    assert words in (DOCS / page).read_text(encoding="utf-8")
