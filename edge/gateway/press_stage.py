"""What a press goes through: each concern of a station is one stage, and `build.py` lists them in order."""

from collections.abc import Sequence
from dataclasses import dataclass

from edge.core.contact.events import Event, PressSettled
from edge.core.contact.press_detector import Look
from edge.core.contact.reference import View
from edge.core.gel_proof import MadeOn
from edge.core.part_position import PartPosition
from edge.core.press import Press
from edge.core.press_label import PressLabel
from edge.gateway.inspector import Inspector
from edge.gateway.recorder import PressReport
from edge.store.gel_ledger import GelRecord

__all__ = ["Mounted", "PressStage", "Stages"]


@dataclass(frozen=True)
class Mounted:
    """What a press would be made with now."""

    serial: str
    gel_id: str
    part: PartPosition
    bundle_id: str
    has_contact: bool
    """Whether something presses the gel."""
    made: MadeOn
    """The gel that the bundle was made on."""


class PressStage:
    """One concern of a press. Each method does nothing here: a stage has those that it needs. The loop alone calls it.

    The calls of a press come in this order: `begin`, `admit`, the score, `judge`, `record`. The others are about what
    is mounted, what is seen, and time.
    """

    def mount(self, gel: GelRecord) -> None:
        """Take the gel that is pressed from now on."""

    def use(self, inspector: Inspector) -> None:
        """Take the bundle that judges from now on."""

    def see(self, event: Event) -> None:
        """Take a contact event."""

    def look(self, look: Look) -> None:
        """Take what a frame shows, after its events."""

    def learn(self, first: View | None) -> None:
        """Take the first picture of this gel, float32 (h, w, 3): the free gel was just learnt, or followed."""

    def relearn(self) -> None:
        """Forget what was seen of the free gel: it is learnt again."""

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        """Return what the press that begins is for, None for a part; `label` is the word of the stages before."""
        return label

    def admit(self, press: Press) -> Press:
        """Return the press before its score, rejected where it may not be judged."""
        return press

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """Return the press after its score. settled: None for one that gave no frame."""
        return press

    def record(self, report: PressReport) -> None:
        """Take a press that is in the database. Errors: StoreError."""

    def turn(self, mounted: Mounted | None) -> None:
        """Take one turn of the loop; None before the sensor is known. Errors: StoreError."""


class Stages(PressStage):
    """Several stages, one after the other."""

    def __init__(self, stages: Sequence[PressStage]) -> None:
        self._stages = tuple(stages)

    def mount(self, gel: GelRecord) -> None:
        for stage in self._stages:
            stage.mount(gel)

    def use(self, inspector: Inspector) -> None:
        for stage in self._stages:
            stage.use(inspector)

    def see(self, event: Event) -> None:
        for stage in self._stages:
            stage.see(event)

    def look(self, look: Look) -> None:
        for stage in self._stages:
            stage.look(look)

    def learn(self, first: View | None) -> None:
        for stage in self._stages:
            stage.learn(first)

    def relearn(self) -> None:
        for stage in self._stages:
            stage.relearn()

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        for stage in self._stages:
            label = stage.begin(label)
        return label

    def admit(self, press: Press) -> Press:
        for stage in self._stages:
            press = stage.admit(press)
        return press

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        for stage in self._stages:
            press = stage.judge(press, settled, inspector)
        return press

    def record(self, report: PressReport) -> None:
        for stage in self._stages:
            stage.record(report)

    def turn(self, mounted: Mounted | None) -> None:
        for stage in self._stages:
            stage.turn(mounted)
