"""What the pages say of limits is the program's."""

from pathlib import Path

import pytest

from edge.config.tables import GelTable
from edge.core.binomial import trials_needed
from edge.core.gel_proof import PROVEN_RATE
from edge.store.acts import KEPT_ACTS, KEPT_REFUSALS
from edge.store.database import JOURNAL_LIMIT_BYTES
from edge.store.gel_files import KEPT_GELS
from edge.store.press_store import KEPT_PRESSES

DOCS = Path(__file__).parents[2] / "docs"


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
