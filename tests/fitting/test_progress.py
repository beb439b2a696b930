"""Progress where there is no terminal: a line every tenth, and per cent where there are no steps."""

import sys

import pytest

from calibration.progress import Stages, progress


def test_a_long_stage_is_not_silent(capsys: pytest.CaptureFixture[str]) -> None:
    """Five folds are five lines; a stage that ends at once is one."""
    with Stages() as report:
        for fold in range(5):
            report("threshold", (fold + 1) / 5)
        report("write", 1.0)

    assert capsys.readouterr().err.splitlines() == [
        "threshold: 20 %", "threshold: 40 %", "threshold: 60 %", "threshold: 80 %", "threshold: done", "write: done",
    ]  # fmt: skip


def test_per_cent_are_not_called_steps(capsys: pytest.CaptureFixture[str]) -> None:
    """A simulation reports the part that is done; an evaluation counts presses."""
    assert not sys.stderr.isatty()
    with progress("simulate", 100, unit="%") as advance:
        advance(12)
    with progress("scored", 10) as advance:
        advance(5)

    assert capsys.readouterr().err.splitlines() == ["simulate: 12 %", "scored: 5 of 10"]
