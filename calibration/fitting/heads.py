"""The head of a fitted bank: a prebuilt one where it fits, else a new one."""

from typing import Any

from edge.core.detector import Bank, Detector, Grid
from edge.core.errors import FitError
from edge.extras import is_installed
from plugins.detectors.prebuilt_heads import must_be_written, prebuilt_head

__all__ = ["check_head", "head_of"]


def check_head(detector: Detector, grid: Grid, parameters: Any) -> None:
    """Check before the work that a head ships or can be written. Errors: FitError with the package to install."""
    if must_be_written(detector, grid, parameters) and not is_installed("onnx"):
        raise FitError(_missing(detector, grid, "onnx"))


def head_of(detector: Detector, grid: Grid, bank: Bank, parameters: Any) -> bytes:
    """The serialised graph for this grid, bank and parameters. Errors: FitError where it must be written and cannot."""
    found = prebuilt_head(detector, grid, bank, parameters)
    if found is not None:
        return found
    try:
        return detector.head(grid, bank, parameters)
    except ImportError as error:
        raise FitError(_missing(detector, grid, error.name)) from error


def _missing(detector: Detector, grid: Grid, package: str | None) -> str:
    h, w = grid.frame
    return (
        f"no head ships for {detector.name} with these settings on {w}x{h} and this trunk, and to write one the "
        f"package {package} is missing; pip install 'gelgate[export]', or fit with the method's own settings on "
        "the default region and backbone"
    )
