"""Work in processes."""

import signal

from calibration.simulator.workers import in_processes


def is_deaf(_: int) -> bool:
    """Tell whether this process holds Ctrl-C back, as one that was started so does."""
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_worker_hears_no_ctrl_c_from_its_start() -> None:
    """Until it is set up it would end with a traceback."""
    assert list(in_processes(is_deaf, range(3), 2)) == [True] * 3
    assert not is_deaf(0)
