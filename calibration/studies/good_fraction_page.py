"""The page of the good-fraction study."""

from typing import TYPE_CHECKING

from calibration.studies.page import Page

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["page"]


def page(rows: "pd.DataFrame") -> Page:
    """The page from its rows."""
    return Page(f"# How many presses a part needs\n\n{len(rows)} rows.\n")
