"""The paper's three validations as studies of independent cells, and the reports made from their rows.

From Python: `from calibration.studies import good_fraction, tradeoff, figure`; all that a notebook needs is here.
"""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.studies.notebook import bad_presses, cross_position, figure, good_fraction, resolution

    # Of a higher room, which this one may not name: `calibration.tradeoff.notebook` has their arguments.
    tradeoff: Callable[..., Any]
    tradeoff_figure: Callable[..., Any]

__all__ = [
    "bad_presses",
    "cross_position",
    "figure",
    "good_fraction",
    "resolution",
    "tradeoff",
    "tradeoff_figure",
]

_TRADEOFF = ("tradeoff", "tradeoff_figure")


def __getattr__(name: str) -> Any:
    """Imported at use: the command line imports this package for its help."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    home = "calibration.tradeoff.notebook" if name in _TRADEOFF else "calibration.studies.notebook"
    return getattr(import_module(home), name)
