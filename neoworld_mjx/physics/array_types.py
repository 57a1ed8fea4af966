"""Type of arrays that may be on the host or on a device."""

import numpy as np
from jaxtyping import Array

AnyArray = Array | np.ndarray
"""A JAX or NumPy array, for annotations such as `Float[AnyArray, "pop object"]`."""
