"""docs/gel.md: its numbers are the program's."""

from pathlib import Path

from edge.config.tables import GelTable
from edge.core.binomial import trials_needed
from edge.core.gel_proof import PROVEN_RATE

PAGE = (Path(__file__).parents[2] / "docs" / "gel.md").read_text(encoding="utf-8")


def test_the_presses_that_prove_a_bundle_are_the_program_s() -> None:
    """One row for each number of alarms."""
    for alarms in range(3):
        assert f"| {alarms} | {trials_needed(PROVEN_RATE, alarms)} |" in PAGE


def test_the_default_is_named() -> None:
    """The table of the configuration has it too."""
    assert f"| `{GelTable().unproven}`, the default |" in PAGE
