"""Which presses the overview camera admits and, with `overview.select`, which bundle judges them."""

from collections.abc import Callable
from dataclasses import replace

from edge.core.errors import StoreError
from edge.core.overview.rules import OverviewView
from edge.core.part_position import PartPosition
from edge.core.press import Press
from edge.core.press_label import PressLabel
from edge.gateway.overview import Overview
from edge.gateway.part_selection import PartSelection
from edge.gateway.press_stage import PressStage

__all__ = ["Admission", "SelectByCode"]

SelectByCode = Callable[[PartPosition, OverviewView], None]
"""The codes in view name this position: its bundle judges the press that begins. Errors: StoreError."""


class Admission(PressStage):
    """Looks at each part with the overview camera; master pieces and studies are not looked at."""

    def __init__(self, overview: Overview, selection: PartSelection, select: SelectByCode) -> None:
        self._overview = overview
        self._selection = selection
        self._select = select
        self._unselected: str | None = None

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        """Look at the part and select its bundle, before anything of this press is judged."""
        if label is None:
            self._look()
        return label

    def _look(self) -> None:
        view = self._overview.begin()
        rules, selection = self._overview.rules, self._selection
        self._unselected = None
        part = rules.choose_position(view, selection.bundles.named_by) if rules.select else None
        if part is not None and part != selection.part:
            try:
                self._select(part, view)
            except StoreError as error:
                self._unselected = str(error)

    def admit(self, press: Press) -> Press:
        """Return it with what was seen when it began, and rejected where that refuses it."""
        if press.label is not None:
            return press
        view, selection = self._overview.take(), self._selection
        refusal = self._overview.rules.refusal(view, selection.part, selection.bundles.named_by)
        if refusal is not None and self._unselected is not None:
            refusal = replace(refusal, text=f"{refusal.text}; it could not be selected: {self._unselected}")
        self._unselected = None
        seen = replace(press, overview=view)
        return seen if refusal is None else seen.reject(refusal)
