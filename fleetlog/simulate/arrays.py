"""Short names for the arrays of the simulator."""

import numpy as np
from numpy.typing import NDArray

Modes = NDArray[np.int8]
