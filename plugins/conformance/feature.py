"""What every feature of presses must do, in a station that inspects recorded presses. Its package is installed."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from pydantic import ValidationError

from edge import registry
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import Press
from edge.core.sentence import Sentence
from edge.messaging.alarm_payload import ALARMS, list_alarms
from edge.press_stage import PressStage
from plugins.conformance.played_station import PRESSES, PlayedStation, open_played
from plugins.conformance.running import collect, require, run_all

__all__ = ["FEATURE_CHECKS", "FeatureCase", "check_feature"]


class FeatureCase:
    """A feature by its entry point's name. It takes part in every station that is opened."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def kind(self) -> type[PressStage]:
        """Its class."""
        feature = registry.feature(self.name)
        is_stage = isinstance(feature, type) and issubclass(feature, PressStage)
        require(
            is_stage, f"'{self.name}' of gelgate.features is {feature!r:.80}, expected a class of PressStage"
        )
        return feature  # type: ignore[return-value]

    @contextmanager
    def station(self, first: PressStage | None = None) -> Iterator[PlayedStation]:
        """Open a station in a new folder. first: a stage before the others."""
        with TemporaryDirectory() as folder, open_played(Path(folder), first) as station:
            yield station


def check_feature(name: str) -> None:
    """Run every check, each in a new station. Errors: ExceptionGroup."""
    run_all(f"feature {name}", FEATURE_CHECKS, lambda: FeatureCase(name))


def check_it_is_a_feature(case: FeatureCase) -> None:
    """The entry point is a class of PressStage, each of whose requests and alarms is explained."""
    for command in case.kind.commands:
        require(bool(command.verb and command.help), f"the request '{command.verb}' has no help")
    require(bool({*case.kind.alarms} <= {*list_alarms()}), f"{[*case.kind.alarms]} are not known as alarms")


def check_presses_are_recorded(case: FeatureCase) -> None:
    """Every press is recorded once, and the damaged one does not pass."""
    with case.station() as station:
        station.play()
        words = [result.verdict for result in station.results]
    require(len(words) == len(PRESSES), f"{len(words)} of {len(PRESSES)} presses are recorded")
    passed = [n for n, (word, true) in enumerate(zip(words, PRESSES, strict=True)) if word == "pass" != true]
    require(not passed, f"press {passed} is damaged and passes")


def check_presses_without_a_score(case: FeatureCase) -> None:
    """A press that is rejected, and one that could not be scored, are recorded as such."""
    with case.station(Refusing()) as station:
        station.play()
        records = [(result.verdict, result.error) for result in station.results]
    require(
        records[:2] == [("rejected", None), (None, Refusing.fault)], f"they are recorded as {records[:2]}"
    )
    require(len(records) == len(PRESSES), f"{len(records)} of {len(PRESSES)} presses are recorded")


def check_alarms_are_declared(case: FeatureCase) -> None:
    """Each alarm that it raises while presses are inspected is known: others are not published."""
    with case.station() as station:
        station.play()
        unknown = {*station.raised} - {*ALARMS, *list_alarms()}
    require(not unknown, f"{sorted(unknown)} is not in `alarms` of its class")


def check_words(case: FeatureCase) -> None:
    """In each language a text has the values of the English one, in braces."""
    for language, words in case.kind.words.items():
        for text, translation in words.items():
            values, translated_values = ({*re.findall(r"\{\w+\}", one)} for one in (text, translation))
            require(
                values == translated_values,
                f"'{text}' has the values {sorted(values)}, in '{language}' {sorted(translated_values)}",
            )


def check_requests(case: FeatureCase) -> None:
    """A request without arguments is answered with plain JSON, before the first press and after the last one."""
    with case.station() as station:
        for _ in range(2):
            for command in case.kind.commands:
                try:
                    command.arguments()
                except ValidationError:
                    continue  # it needs arguments, which its author knows
                json.dumps(dict(station.ask(command.verb)))
            station.play()


def check_a_restart(case: FeatureCase) -> None:
    """A station starts again on the database that the feature leaves."""
    with TemporaryDirectory() as folder:
        for _ in range(2):
            with open_played(Path(folder)) as station:
                station.play()
                require(len(station.results) == len(PRESSES), f"it recorded {len(station.results)} presses")


def check_closed_twice(case: FeatureCase) -> None:
    """Closing without a start, and twice, is harmless."""
    with case.station() as station:
        stage = station.loop.find(case.kind)
        for _ in range(2):
            if stage is not None:
                stage.close()


FEATURE_CHECKS: Final[tuple[Callable[[FeatureCase], None], ...]] = collect(globals(), FeatureCase)


class Refusing(PressStage):
    """Rejects the first press, and has a fault with the second."""

    fault = "the press was not scored"

    def __init__(self) -> None:
        self._presses = 0

    def admit(self, press: Press) -> Press:
        self._presses += 1
        if self._presses == 1:
            return press.reject(Rejection(Reason.FEATURE, Sentence("the check refuses it")))
        return replace(press, error=self.fault) if self._presses == 2 else press
