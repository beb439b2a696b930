"""Peak memory is measured in processes of its own; one that dies is a sentence, and nothing waits for it."""

from pathlib import Path

import pytest
from study_cells import dies

from calibration.experiments.tradeoff.memory import peak_bytes
from edge.core.errors import FitError


def test_a_process_that_is_killed_is_a_sentence() -> None:
    """As one out of memory is: the bundle is named, and what to do."""
    with pytest.raises(
        FitError, match="measures the memory of 'spade' died, perhaps for lack of memory; free some"
    ):
        peak_bytes([Path("bundles/spade")], 1, measure=dies)
