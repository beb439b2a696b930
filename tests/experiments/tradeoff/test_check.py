"""What has become worse since an earlier run."""

import copy

import pytest
from tradeoff_rows import MACHINE, row

from calibration.experiments.tradeoff.check import check
from edge.core.errors import ConfigError

BEFORE = [row("padim.t.lr.20", 0.75, ms=20.0), row("spade.t.lr.20", 0.80, ms=24.0)]


def after(**changes: object) -> list[dict[str, object]]:
    """The same rows, the first with some values changed."""
    rows = copy.deepcopy(BEFORE)
    rows[0].update(changes)
    return rows


def losses(rows: list[dict[str, object]]) -> list[str]:
    return check(BEFORE, rows)[0]


def test_the_same_run_has_no_loss() -> None:
    """And nothing is left out."""
    assert check(BEFORE, after()) == ([], [])


def test_a_lower_accuracy_is_a_loss_with_point_and_figure() -> None:
    """0.006 less is one, 0.004 less is arithmetic."""
    lower, noise = (copy.deepcopy(BEFORE[0]["accuracy"]) for _ in range(2))
    lower["aupro_fpr01"]["value"], noise["aupro_fpr01"]["value"] = 0.744, 0.746
    assert losses(after(accuracy=lower)) == [
        "padim.t.lr.20: AU-PRO up to 1 % false positives is 0.7440, it was 0.7500"
    ]
    assert losses(after(accuracy=noise)) == []


def test_a_slower_ratio_is_a_loss_beyond_its_interval_alone() -> None:
    """20 % slower is one; 4 % slower with intervals that nearly meet is noise; milliseconds alone do not count."""
    assert losses(after(ratio={"median": 3.43, "low": 3.4, "high": 3.46})) == [
        "padim.t.lr.20: a press takes 3.430 times the bare trunk (3.400 to 3.460), it took 2.857 (2.829 to 2.886)"
    ]
    assert losses(after(ratio={"median": 2.97, "low": 2.95, "high": 3.0})) == []
    assert losses(after(ms={"median": 90.0, "low": 89.0, "high": 91.0, "p95": 99.0})) == []


def test_a_larger_bank_and_more_memory_are_losses() -> None:
    """Bytes beyond 1 %, memory beyond 10 %."""
    assert losses(after(bank_bytes=1_020_000)) == [
        "padim.t.lr.20: the bank has 1020000 bytes, it had 1000000"
    ]
    assert losses(after(peak_memory_bytes=115_000_000)) == [
        "padim.t.lr.20: the peak memory is 115 MB, it was 100 MB"
    ]
    assert losses(after(bank_bytes=1_005_000, peak_memory_bytes=105_000_000)) == []


def test_a_missing_point_is_a_loss() -> None:
    """It cannot be seen to be as good as before."""
    assert losses(after()[1:]) == ["padim.t.lr.20: the point is missing, it was measured before"]


def test_times_of_another_machine_are_not_compared() -> None:
    """A remark says so; accuracy still is."""
    rows = after(ratio={"median": 9.0, "low": 8.9, "high": 9.1})
    rows[0]["machine"] = MACHINE | {"processor": "another"}
    found, remarks = check(BEFORE, rows)
    assert found == []
    assert remarks == ["times and memory are not compared: the earlier run was on another machine"]


@pytest.mark.parametrize(("name", "value"), [("dataset_sha256", "00"), ("seed", 1)])
def test_other_presses_or_another_seed_are_refused(name: str, value: object) -> None:
    """Their difference would be taken for a loss."""
    with pytest.raises(ConfigError, match=f"the earlier rows have {name}"):
        check(BEFORE, after(**{name: value}))
