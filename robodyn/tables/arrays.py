"""The kinds of arrays that functions take and give."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Truth = NDArray[np.bool_]
