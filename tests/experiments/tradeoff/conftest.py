"""The dataset that several tests of the trade-off share."""

from pathlib import Path

import pytest
from tradeoff_dataset import make_dataset


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight good pieces with three presses each, four defective ones, in low resolution."""
    return make_dataset(tmp_path_factory.mktemp("data") / "small")
