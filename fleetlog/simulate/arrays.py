"""Short names for the arrays of the simulator."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Modes = NDArray[np.int8]
