"""Progress of long work: a bar on a terminal, else a plain line at every tenth, always on stderr."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["Advance", "Report", "Stages", "lines", "progress"]

Advance = Callable[[int], None]
"""Called with the number of steps done."""

Report = Callable[[str, float], None]
"""Called with a stage's name and the fraction that is done."""


# A shorter time left is not worth a number.
_LEAST_LEFT_S = 60.0
# Steps may take a minute each; the bar's usual half minute would then have no estimate.
_ESTIMATED_OVER_S = 900.0


@contextmanager
def progress(what: str, total: int, unit: str = "") -> Iterator[Advance]:
    """Show the progress of `what`; the caller reports steps done, up to `total`. unit: "%" if steps have no name.

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
            done_of = f"{done} %" if unit == "%" else f"{done} of {total}"
            left_s = (clock() - began[1]) * (total - done) / max(done - began[0], 1)
            left = f", about {left_s / 60:.0f} min left" if left_s >= _LEAST_LEFT_S else ""
            print(f"{what}: {done_of}{left}", file=sys.stderr, flush=True)

    return report


class Stages:
    """Progress of named stages: bars on a terminal, else a line at every tenth of a stage."""

    def __init__(self) -> None:
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self._bars = Progress(console=Console(stderr=True), transient=True)

    def __enter__(self) -> Report:
        if self._bars:
            self._bars.start()
        return self._show

    def __exit__(self, *unused: object) -> None:
        if self._bars:
            self._bars.stop()

    def _show(self, stage: str, fraction: float) -> None:
        if self._bars:
            if stage not in self._tasks:
                self._tasks[stage] = self._bars.add_task(stage, total=1.0)
            self._bars.update(self._tasks[stage], completed=fraction)
            return
        tenth = int(10 * fraction + 1e-9)
        if tenth > self._tasks.setdefault(stage, 0):
            self._tasks[stage] = tenth
            print(f"{stage}: {'done' if tenth >= 10 else f'{10 * tenth} %'}", file=sys.stderr, flush=True)
