"""The short form of `make soak`: one round of each fault."""

from pathlib import Path

from soak import FAULTS, Outcome, soak


def test_no_press_is_lost_whatever_happens(tmp_path: Path) -> None:
    """Each press is delivered and counted once, the database is sound, every message is as the station describes it."""
    outcome = soak(tmp_path, len(FAULTS))

    assert set(outcome.faults) == set(FAULTS) - {"no fault"}
    assert outcome.made > 2 * len(FAULTS)
    assert (outcome.delivered, outcome.counted) == (outcome.made, outcome.made), str(outcome)
    assert (outcome.lost, outcome.doubled, outcome.findings) == (0, 0, []), str(outcome)
    assert outcome.checked > 5 * outcome.made
    assert outcome.undescribed == []


def test_what_was_lost_is_said() -> None:
    """The numbers, and the faults by kind."""
    outcome = Outcome(made=9, delivered=8, counted=9, lost=1, findings=["the count was lowered"])
    outcome.checked, outcome.undescribed = 90, ["gel: no number"]
    outcome.faults.update(["gateway killed", "gateway killed", "broker frozen"])

    assert str(outcome) == (
        "faults injected 3 (1 broker frozen, 2 gateway killed)\n"
        "presses made 9, delivered 8, counted 9, lost 1, doubled 0\n"
        "messages checked 90, not as described 1\n"
        "gel: no number\n"
        "the database: the count was lowered"
    )
