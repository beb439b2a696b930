"""Work in the background: one job at a time, and none of them ends the thread."""

import pytest

from edge.background import Background


def test_a_job_that_raises_is_in_the_log_and_the_next_one_is_done(caplog: pytest.LogCaptureFixture) -> None:
    """It has no outcome, and nothing is busy after it."""
    worker: Background[float] = Background("sums", 0)
    worker.ask(lambda: 1 / 0)
    worker.step()
    assert (worker.take(), worker.is_busy) == (None, False)
    assert "the job of thread 'sums' failed: division by zero" in caplog.text

    worker.ask(lambda: 2.0)
    worker.step()
    assert (worker.take(), worker.is_busy) == (2.0, False)
