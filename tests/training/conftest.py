"""Fixtures of the training tests; without torch none of these tests is collected."""

from typing import TYPE_CHECKING

import pytest

from edge.extras import is_installed

if TYPE_CHECKING:
    from calibration.training.network import TrunkNetwork

if not is_installed("torch"):
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture(scope="module")
def trunk() -> "TrunkNetwork":
    """A random network whose batch norms have statistics."""
    import torch

    from calibration.training.network import TrunkNetwork

    torch.manual_seed(0)
    network = TrunkNetwork()
    with torch.no_grad():
        for _ in range(3):
            network(torch.rand(4, 3, 64, 64) * 255)
    return network.eval()
