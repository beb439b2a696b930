"""Counts the presses of each shift of eight hours, and answers with them."""

from collections import Counter
from datetime import UTC, datetime
from typing import ClassVar, Self

from edge.core.press import Press
from edge.messaging.alarm_payload import Alarm
from edge.messaging.command_payloads import NoArguments
from edge.press_stage import Alarms, Command, Data, PressStage, StageParts
from edge.store.gel_ledger import GelRecord

GOAL = 3
"""Parts of a shift."""


class Shifts(PressStage):
    """A press goes through one stage of each feature. `PressStage` says when each method is called."""

    alarms: ClassVar = {"template": Alarm("end the shift")}

    def __init__(self, alarms: Alarms) -> None:
        self._alarms, self._counts = alarms, Counter[str]()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Make the stage of a station."""
        return cls(parts.alarms)

    def record(self, press: Press, gel: GelRecord) -> None:
        """Count a press that is in the database."""
        shift = f"shift {datetime.fromtimestamp(press.time_ns / 1e9, UTC).hour // 8 + 1}"
        self._counts[shift] += 1
        if self._counts[shift] == GOAL:
            self._alarms.say("template", f"{shift} has its parts", "warning")

    def answer(self, arguments: NoArguments) -> Data:
        """Return the presses of each shift."""
        return dict(self._counts)

    commands = (Command("template", NoArguments, answer, "the presses of each shift"),)


plugin = Shifts
