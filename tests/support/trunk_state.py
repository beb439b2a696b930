"""The weights of a trunk as `build_trunk` takes them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def state_arrays(trunk: Any) -> dict[str, NDArray[np.float32]]:
    """The weights under torchvision's names, float32 arrays, without batch counters."""
    return {
        name: value.detach().float().cpu().numpy().copy()
        for name, value in trunk.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }
