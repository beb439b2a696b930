"""Progress where there is no terminal: a line every tenth, and per cent where there are no steps."""

import pytest

from calibration.progress import Stages, lines


def test_a_long_stage_is_not_silent(capsys: pytest.CaptureFixture[str]) -> None:
    """Five folds are five lines; a stage that ends at once is one."""
    with Stages() as report:
        for fold in range(5):
            report("threshold", (fold + 1) / 5)
        report("write", 1.0)

    assert capsys.readouterr().err.splitlines() == [
        "threshold: 20 %", "threshold: 40 %", "threshold: 60 %", "threshold: 80 %", "threshold: done", "write: done",
    ]  # fmt: skip


def test_plain_lines_say_the_time_left(capsys: pytest.CaptureFixture[str]) -> None:
    """At every tenth; what an earlier run did is not counted as fast work of this one. Less than
    a minute is not worth a number."""
    now = [0.0]
    advance = lines("cells", 100, clock=lambda: now[0])
    advance(50)
    for done in range(51, 101):
        now[0] += 30.0
        advance(done)

    assert capsys.readouterr().err.splitlines() == [
        "cells: 50 of 100",
        "cells: 60 of 100, about 20 min left",
        "cells: 70 of 100, about 15 min left",
        "cells: 80 of 100, about 10 min left",
        "cells: 90 of 100, about 5 min left",
        "cells: 100 of 100",
    ]

    advance = lines("cells", 2, clock=lambda: now[0])
    for done in (1, 2):
        now[0] += 30.0
        advance(done)
    assert capsys.readouterr().err == "cells: 1 of 2\ncells: 2 of 2\n"
