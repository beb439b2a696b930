"""The head of a fitted bank: the one that ships where it fits, else written anew."""

from typing import Any

from edge.core.detector import Bank, Detector, Grid
from edge.core.errors import FitError
from plugins.detectors.shipped import shipped_head

__all__ = ["head_of"]


def head_of(detector: Detector, grid: Grid, bank: Bank, parameters: Any) -> bytes:
    """The serialised graph for this grid, bank and parameters. Errors: FitError where it must be written and cannot."""
    shipped = shipped_head(detector, grid, bank, parameters)
    if shipped is not None:
        return shipped
    try:
        return detector.head(grid, bank, parameters)
    except ImportError as error:
        h, w = grid.frame
        raise FitError(
            f"no head ships for {detector.name} with these settings on {w}x{h} and this trunk, and to write one the "
            f"package {error.name} is missing; pip install 'gelgate[export]', or fit with the method's own settings on "
            "the default region and backbone"
        ) from error
