"""Names for arrays, by the type of their numbers."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["F32", "F64", "U8", "Mask"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]
