"""Bundles that register their presses, for other programs."""

import pytest
from registered_bundle import registered

from edge.core.errors import BundleMismatch
from export.merge import merged_graph


def test_a_bundle_that_registers_its_presses_is_no_single_graph() -> None:
    """Another program would score presses as they lie: it is refused with what to do."""
    with pytest.raises(BundleMismatch, match="fit it again with --register never"):
        merged_graph(registered().bundle())
