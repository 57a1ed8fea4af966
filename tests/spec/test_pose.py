"""Products of quaternions against rotation matrices."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neoworld_mjx.spec.pose import quat_mul, rotate


@pytest.mark.parametrize("xp", [np, jnp])
@pytest.mark.parametrize("shape", [(), (5,)])
def test_the_product_turns_by_the_second_quaternion_first(xp, shape):
    a, b, point = np.random.default_rng(0).normal(size=(3, *shape, 4))
    a, b = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in (a, b))
    first, second = (Rotation.from_quat(q, scalar_first=True) for q in (b, a))
    expected = second.apply(first.apply(point[..., :3]))
    product = quat_mul(xp.asarray(a), xp.asarray(b), xp)
    found = np.asarray(rotate(product, xp.asarray(point[..., :3]), xp))
    np.testing.assert_allclose(found, expected, atol=1e-5)
