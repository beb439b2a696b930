"""What the tests of training share."""

import pytest
import torch

from calibration.training.network import Trunk


@pytest.fixture(scope="module")
def trunk() -> Trunk:
    """A random network whose batch norms have seen something."""
    torch.manual_seed(0)
    network = Trunk()
    with torch.no_grad():
        for _ in range(3):
            network(torch.rand(4, 3, 64, 64) * 255)
    return network.eval()
