"""Counts the presses of each shift of eight hours, and answers with them."""

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, ClassVar, Self

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
    alarms: ClassVar = {"template": Alarm("end the shift", title="The shift is full")}
    words: ClassVar = {
        "de": {
            "The shift is full": "Die Schicht ist voll",
            "end the shift": "die Schicht beenden",
            "{shift} has its parts": "{shift} hat ihre Teile",
        }
    }

    def __init__(self, options: FeatureOptions, alarms: Alarms) -> None:
        self._options, self._alarms, self._counts = options, alarms, Counter[str]()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        """Make the stage of a station."""
        return cls(parts.options, parts.alarms)

    def fields(self, press: Press) -> Mapping[str, Any]:
        """Say how many parts were pressed before; the result has it under `feature`."""
        return {"before": self._counts.total()}

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
