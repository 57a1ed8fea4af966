"""Type of arrays that functions take both from the host and from a device."""

import numpy as np
from jaxtyping import Array

AnyArray = Array | np.ndarray
"""An array of JAX or of NumPy, for annotations such as `Float[AnyArray, "pop object"]`."""
