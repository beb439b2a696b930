"""Progress of long work: a bar on a terminal, else a plain line at every tenth, always on stderr; and what it takes."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

__all__ = ["Advance", "Report", "Show", "StageTimes", "Stages", "lines", "progress"]

Advance = Callable[[int], None]
"""Called with the number of steps done."""

Report = Callable[[str, float], None]
"""Called with a stage's name and the fraction that is done."""

Show = Callable[[str, int], AbstractContextManager[Advance]]
"""Opens a progress display: what is done, and how many steps."""

# A shorter time left is not worth a number.
_LEAST_LEFT_S = 60.0
# Steps may take a minute each; the bar's usual half minute would then have no estimate.
_ESTIMATED_OVER_S = 900.0


@contextmanager
def progress(what: str, total: int, unit: str = "") -> Iterator[Advance]:
    """Show the progress of `what`; the caller reports steps done, up to `total`. unit: "%" where steps are hundredths.

    Work that continues earlier work reports first what is done already; the time left is estimated without it.
    """
    if sys.stderr.isatty():
        yield from _bar(what, total)
    else:
        yield lines(what, total, unit)


def _bar(what: str, total: int) -> Iterator[Advance]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, speed_estimate_period=_ESTIMATED_OVER_S) as bar:
        task = bar.add_task(what, total=total)
        is_first = True

        def advance(done: int) -> None:
            nonlocal is_first
            if is_first:
                bar.reset(task, completed=done)
            else:
                bar.update(task, completed=done)
            is_first = False

        yield advance


def lines(what: str, total: int, unit: str = "", clock: Callable[[], float] = time.monotonic) -> Advance:
    """A line on stderr at every tenth, with the time left where it is a minute or more. clock: seconds."""
    shown = 0
    began: tuple[int, float] | None = None

    def report(done: int) -> None:
        nonlocal shown, began
        began = began or (done, clock())
        tenth = 10 * done // max(total, 1)
        if tenth > shown:
            shown = tenth
            done_of = f"{done} of {total}" if unit != "%" else f"{done} %" if done < total else "done"
            left_s = (clock() - began[1]) * (total - done) / max(done - began[0], 1)
            left = f", about {left_s / 60:.0f} min left" if left_s >= _LEAST_LEFT_S else ""
            print(f"{what}: {done_of}{left}", file=sys.stderr, flush=True)

    return report


class Stages:
    """Progress of named stages, one after the other, by the fraction of each that is done."""

    def __init__(self) -> None:
        self._stage, self._advance, self._shown = "", lines("", 0), ExitStack()

    def __enter__(self) -> Report:
        return self._show

    def __exit__(self, *unused: object) -> None:
        self._shown.close()

    def _show(self, stage: str, fraction: float) -> None:
        if stage != self._stage:
            self._shown.close()
            self._stage = stage
            self._advance = self._shown.enter_context(progress(stage, 100, "%"))
        self._advance(int(100 * fraction + 1e-9))


class StageTimes:
    """Reports how far a fit is, and measures the processor time of its stages."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.seconds: dict[str, float] = {}

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Add what is done within it to the stage."""
        start = time.process_time()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.process_time() - start
