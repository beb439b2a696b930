"""Counts the presses of each shift of eight hours, and answers with them."""

from collections import Counter
from datetime import UTC, datetime
from typing import ClassVar, Self

from pydantic import BaseModel, Field

from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.messaging.alarm_payload import Alarm
from edge.messaging.command_payloads import NoArguments
from edge.press_stage import Alarms, Command, Data, PressStage, StageParts
from edge.store.gel_ledger import GelRecord


class FeatureOptions(BaseModel, extra="forbid", frozen=True):
    """The keys of its table `[feature.template]` in the configuration."""

    goal: int = Field(default=3, ge=1, description="parts of a shift")


class Shifts(PressStage):
    """A press goes through one stage of each feature. `PressStage` says when each method is called."""

    Options = FeatureOptions
    alarms: ClassVar = {"template": Alarm("end the shift")}

    def __init__(self, options: FeatureOptions, alarms: Alarms) -> None:
        self._options, self._alarms, self._counts = options, alarms, Counter[str]()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Make the stage of a station."""
        return cls(parts.options, parts.alarms)

    def record(self, press: Press, gel: GelRecord) -> None:
        """Count a press that is in the database."""
        shift = f"shift {datetime.fromtimestamp(press.time_ns / 1e9, UTC).hour // 8 + 1}"
        self._counts[shift] += 1
        if self._counts[shift] == self._options.goal:
            self._alarms.say("template", Sentence(f"{shift} has its parts"), "warning")

    def answer(self, arguments: NoArguments) -> Data:
        """Return the presses of each shift."""
        return dict(self._counts)

    commands = (Command("template", NoArguments, answer, "the presses of each shift"),)


plugin = Shifts
