"""The paper's three validations as studies of independent cells, and the reports made from their rows.

From Python: `from calibration.experiments.studies import good_fraction, figure`; all that a notebook needs is here.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.experiments.studies.notebook import (
        bad_presses,
        cross_position,
        figure,
        good_fraction,
        resolution,
    )

__all__ = ["bad_presses", "cross_position", "figure", "good_fraction", "resolution"]


def __getattr__(name: str) -> Any:
    """Imported at use: the command line imports this package for its help."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from calibration.experiments.studies import notebook

    return getattr(notebook, name)
