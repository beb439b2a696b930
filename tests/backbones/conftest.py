"""The weights that an extra brings."""

from importlib.metadata import PackageNotFoundError, distribution

import pytest

from plugins.backbones.efficientnet_lite0 import PACKAGE


@pytest.fixture
def package() -> None:
    try:
        distribution(PACKAGE)
    except PackageNotFoundError:
        pytest.skip("SKIPPED, NOT TESTED: the extra `comparison` brings the weights")
