"""A mean with the number of its values."""

from collections.abc import Sequence

import numpy as np

from neoworld_mjx.spec import Spec


class Mean(Spec):
    """A mean and the number of its values. A mean without values is None, because an error that
    was not measured is not an error of zero.
    """

    value: float | None
    n: int


def mean_of_known(values: Sequence[float | None]) -> Mean:
    """Return the mean of the values that are not None."""
    known = [value for value in values if value is not None]
    return Mean(value=float(np.mean(known)) if known else None, n=len(known))
