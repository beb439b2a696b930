"""Which presses the overview camera admits and, with `overview.select`, which bundle judges them."""

from collections.abc import Callable
from dataclasses import replace

from edge.core.errors import StoreError
from edge.core.imaging.quality import Rejection
from edge.core.overview.rules import OverviewView
from edge.core.part_position import PartPosition
from edge.gateway.overview import Overview
from edge.gateway.part_selection import PartSelection

__all__ = ["Admission", "SelectByCode"]

SelectByCode = Callable[[PartPosition, OverviewView], None]
"""The codes in view name this position: its bundle judges the press that begins. Errors: StoreError."""


class Admission:
    """Asked by the press pipeline: `begin` once for each press, then `take`. Used by the loop alone."""

    def __init__(self, overview: Overview, selection: PartSelection, select: SelectByCode) -> None:
        self._overview = overview
        self._selection = selection
        self._select = select
        self._unselected: str | None = None

    def begin(self) -> None:
        """A contact began: look at the part and select its bundle, before anything of this press is judged."""
        view = self._overview.begin()
        rules, selection = self._overview.rules, self._selection
        self._unselected = None
        part = rules.choose_position(view, selection.bundles.named_by) if rules.select else None
        if part is not None and part != selection.part:
            try:
                self._select(part, view)
            except StoreError as error:
                self._unselected = str(error)

    def take(self) -> tuple[OverviewView, Rejection | None]:
        """What was seen when this press began, and why it is not admitted, or None."""
        view, selection = self._overview.take(), self._selection
        refusal = self._overview.rules.refusal(view, selection.part, selection.bundles.named_by)
        if refusal is not None and self._unselected is not None:
            refusal = replace(refusal, text=f"{refusal.text}; it could not be selected: {self._unselected}")
        self._unselected = None
        return view, refusal
