"""The short form of `make soak`: one round of each fault."""

from pathlib import Path

from soak import FAULTS, soak


def test_no_press_is_lost_whatever_happens(tmp_path: Path) -> None:
    """Each press is delivered and counted once, the database is sound, every message is as the station describes it."""
    outcome = soak(tmp_path, len(FAULTS))

    assert set(outcome.faults) == set(FAULTS) - {"no fault"}
    assert outcome.made > 2 * len(FAULTS)
    assert (outcome.delivered, outcome.counted) == (outcome.made, outcome.made), str(outcome)
    assert (outcome.lost, outcome.doubled, outcome.findings) == (0, 0, []), str(outcome)
    assert outcome.checked > 5 * outcome.made
    assert outcome.undescribed == []
