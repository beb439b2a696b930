"""A station without threads and without time of its own: a test says when the sensor is read and the loop looks."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from sql import execute

from edge.clock import ManualClock
from edge.config import load_config
from edge.core.errors import RecordingEnded
from edge.gateway.build import open_station
from edge.gateway.command_table import every_command
from edge.gateway.recorder import PressReport
from edge.messaging.result_payload import ResultPayload
from edge.press_stage import PressStage
from edge.store.press_store import Store

S = TypeVar("S", bound=PressStage)

# Of its own time: no recording is as long.
_LONGEST_NS = 86_400 * 10**9


class SteppedStation:
    """`read` is the reader's thread, `look` is the loop's; the clock moves as the recording is read."""

    def __init__(
        self,
        config: Path,
        stages: Mapping[str, PressStage] | None = None,
        on_press: Callable[[PressReport], None] = lambda report: None,
    ) -> None:
        self.clock = ManualClock()
        self.reports: list[PressReport] = []
        self.has_ended = False
        self._pause_s = 0.0  # before the next step of the reader; the loop may look meanwhile
        self._closing = ExitStack()

        def note(report: PressReport) -> None:
            self.reports.append(report)
            on_press(report)

        read = partial(load_config, config)
        opened = open_station(read(), self.clock, note, None, read, stages)
        self.loop = self._closing.enter_context(opened)
        self.parts = self.loop.parts

    def find(self, kind: type[S]) -> S:
        """Return the stage of this kind, which is configured."""
        stage = self.loop.find(kind)
        assert stage is not None
        return stage

    def ask(self, verb: str, **arguments: Any) -> Any:
        """Do a request at once, as the loop does it; returns the data of its response."""
        command = next(command for command in every_command() if command.verb == verb)
        return command.do(self.loop, command.arguments.of(arguments))

    @property
    def results(self) -> list[ResultPayload]:
        """The results of the presses so far."""
        return [report.result for report in self.reports]

    @property
    def verdicts(self) -> list[str | None]:
        """The verdict of each press so far."""
        return [result.verdict for result in self.results]

    def said(self, topic: str) -> Any:
        """Return the newest message of a topic that has no history, as JSON; None where it is empty."""
        kept = {
            message.topic: message.payload for _, message in self.parts.publisher.retained_state.since(-1)
        }
        return json.loads(kept[topic]) if kept.get(topic) else None

    def alarm(self, name: str) -> str | None:
        """Return the text of the alarm; None where it is not raised."""
        said = self.said(f"alarm/{name}")
        return said and said["text"]

    def publish(self) -> None:
        """Let each publisher's thread take one turn."""
        for worker in self.parts.publisher.workers.values():
            worker.step()

    @property
    def raised(self) -> list[str]:
        """The alarms that are raised, in order."""
        return sorted(self.parts.status.view().alarms)

    def read(self, steps: int) -> None:
        """This number of steps of the reader: the first opens the sensor, each other one reads a frame."""
        for _ in range(steps):
            self.clock.sleep(self._pause_s)
            try:
                self._pause_s = self.parts.acquisition.step()
            except RecordingEnded:
                self.has_ended = True
                return

    def look(self) -> None:
        """Let the loop look at every frame that waits; it stops where it halts."""
        while (frame := self.parts.acquisition.next(0)) is not None:
            self.loop.step(frame)
            self.parts.pictures.step()
            if self.loop.is_halted:
                return

    def turn(self, count: int = 1) -> None:
        """Let the loop take this number of turns without a frame."""
        for _ in range(count):
            self.loop.step(None)
            self.parts.pictures.step()

    def play(self, steps: int | None = None) -> None:
        """Read and look in turn, to the recording's end or for this number of steps."""
        while not self.has_ended and steps != 0:
            self.read(1)
            self.look()
            steps = None if steps is None else steps - 1

    def play_until(self, is_so: Callable[[], bool]) -> None:
        """Read and look in turn until that is so; a recording that ends before is a failure, and a sensor that cannot
        be opened, as one that another station holds."""
        until_ns = self.clock.monotonic_ns() + _LONGEST_NS
        while not is_so():
            assert not self.has_ended, "the recording is over, and it did not come to that"
            assert self.clock.monotonic_ns() < until_ns, f"nothing comes: {self.alarm('device')}"
            self.play(1)

    def play_presses(self, number: int) -> None:
        """Read and look in turn until this number of presses is recorded, and the gel is free again."""
        self.play_until(lambda: len(self.reports) == number and not self.loop.session.has_contact)

    def reload(self) -> None:
        """Read the configuration again, open its bundles, and let the loop take them."""
        self.parts.selection.reload()
        self.parts.selection.worker.step()
        self.turn()

    @property
    def bundle_id(self) -> str:
        """Of the bundle in use."""
        return self.parts.selection.inspector.bundle.digest

    @contextmanager
    def refusing(self, table: str) -> Iterator[None]:
        """Inside, the database takes no new row of that table: "no room"."""
        path = self.parts.store.path
        execute(path, f"CREATE TRIGGER no BEFORE INSERT ON {table} BEGIN SELECT RAISE(FAIL, 'no room'); END")
        try:
            yield
        finally:
            execute(path, "DROP TRIGGER no")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.close()


def correct_counts(store: Store, sentence: str) -> None:
    """As after a database was lost."""
    statement = "INSERT INTO corrected_counts (sentence) VALUES (?)"
    store.write("correcting counts", lambda connection: connection.execute(statement, (sentence,)))
