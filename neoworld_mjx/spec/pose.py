"""Rotations and rigid poses in NumPy.

Quaternions are (w, x, y, z), float64, shape [..., 4].
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ArrayLike = NDArray | Sequence[Any] | float
"""Input of `np.asarray`. The ArrayLike of NumPy cannot be checked at run time."""

IDENTITY = (1.0, 0.0, 0.0, 0.0)
SINGLE_ROUNDING = 2e-7
"""Largest angle [rad] that single precision does not resolve."""


class Pose(NamedTuple):
    """A rigid transform: x -> rotate(quat, x) + pos."""

    pos: NDArray
    """Translation [m], shape [3]."""
    quat: NDArray
    """Unit quaternion (w, x, y, z), shape [4]."""

    def apply(self, points: ArrayLike) -> NDArray:
        """Transform points [m], shape [..., 3]."""
        return rotate(self.quat, points) + self.pos

    def then(self, inner: "Pose") -> "Pose":
        """Return the composition of both transforms, which applies `inner` first."""
        return Pose(self.apply(inner.pos), quat_mul(self.quat, inner.quat))

    def inverse(self) -> "Pose":
        """Return the inverse transform."""
        back = conjugate(self.quat)
        return Pose(-rotate(back, self.pos), back)


def pose(pos: ArrayLike = (0.0, 0.0, 0.0), quat: ArrayLike = IDENTITY) -> Pose:
    """Return a pose from a position [m] and a quaternion, which is normalized."""
    q = np.asarray(quat, float)
    return Pose(np.asarray(pos, float), q / np.linalg.norm(q))


def triple(values: NDArray) -> tuple[float, float, float]:
    """Convert an array of three numbers to a tuple of floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def quat_mul(a: Any, b: Any, xp: Any = np) -> Any:
    """Multiply quaternions [..., 4]; the product applies the rotation `b` first.

    Args:
        a: quaternions.
        b: quaternions; leading axes broadcast.
        xp: `numpy`, which computes in double precision, or `jax.numpy` for traced arrays.
    """
    if xp is np:
        a, b = np.asarray(a, float), np.asarray(b, float)
        if a.ndim == b.ndim == 1:
            return np.array(_product(a.tolist(), b.tolist()))
    a_parts, b_parts = ([q[..., k] for k in range(4)] for q in (a, b))
    return xp.stack(_product(a_parts, b_parts), axis=-1)


def _product(a: list[Any], b: list[Any]) -> list[Any]:
    """Multiply quaternions given as four arrays, or as four floats (six times as fast)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]


def conjugate(quat: ArrayLike) -> NDArray:
    """Return the inverse of unit quaternions [..., 4]."""
    return np.asarray(quat, float) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(quat: Any, points: Any, xp: Any = np) -> Any:
    """Rotate points [..., 3] by quaternions [..., 4].

    Args:
        quat: quaternions.
        points: points; leading axes broadcast.
        xp: `numpy`, which computes in double precision, or `jax.numpy` for traced arrays.
    """
    if xp is np:
        quat, points = np.asarray(quat, float), np.asarray(points, float)
    w, u = quat[..., :1], quat[..., 1:]
    product = cross if xp is np else xp.cross
    t = 2.0 * product(u, points)
    return points + w * t + product(u, t)


def cross(a: NDArray, b: NDArray) -> NDArray:
    """Return the cross product of vectors [..., 3], ten times faster than np.cross for one pair."""
    if a.ndim == b.ndim == 1:
        (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
        return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def matrix(quat: ArrayLike) -> NDArray:
    """Convert a unit quaternion [4] to a rotation matrix [3, 3]."""
    return rotate(np.asarray(quat, float), np.eye(3)).T


def from_matrix(rotation: ArrayLike) -> NDArray:
    """Convert a rotation matrix [3, 3] to a quaternion [4] with w >= 0."""
    r = np.asarray(rotation, float)
    # The row with the largest diagonal entry is numerically safe (Shepperd's method).
    four = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    k = int(np.argmax(four))
    rows = [
        [four[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], four[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], four[2], r[2, 1] + r[1, 2]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], four[3]],
    ]
    q = np.array(rows[k])
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def from_axis_angle(axis: ArrayLike, angle: float) -> NDArray:
    """Return the rotation by `angle` [rad] about `axis`, which is normalized."""
    a = np.asarray(axis, float)
    a = a / np.linalg.norm(a)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * a])


def from_yaw(yaw: float) -> NDArray:
    """Return the rotation by `yaw` [rad] about +z."""
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def from_rpy(roll: float, pitch: float, yaw: float) -> NDArray:
    """Convert fixed-axis roll, pitch, yaw [rad] of URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    q = quat_mul(from_axis_angle((0, 1, 0), pitch), from_axis_angle((1, 0, 0), roll))
    return quat_mul(from_yaw(yaw), q)


def to_rpy(quat: ArrayLike) -> NDArray:
    """Return roll, pitch, yaw [rad], the inverse of `from_rpy`; at pitch +-90 degrees, yaw is 0."""
    r = matrix(quat)
    pitch = np.arcsin(np.clip(-r[2, 0], -1.0, 1.0))
    if abs(r[2, 0]) > 1 - 1e-12:
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def yaw_of(quat: ArrayLike) -> float:
    """Return the yaw [rad] of a rotation, by its swing-twist decomposition about +z."""
    w, _, _, z = np.asarray(quat, float)
    return float(2.0 * np.arctan2(z, w))


def angle_between(a: Any, b: Any, xp: Any = np) -> Any:
    """Return the angle in [0, pi] [rad] of the rotation from unit quaternion(s) a to b.

    The result is accurate at every angle. The signs of the quaternions do not matter.

    Args:
        a: quaternions [..., 4].
        b: quaternions [..., 4]; leading axes broadcast.
        xp: `numpy`, which computes in double precision, or `jax.numpy` for traced arrays. With
            `jax.numpy`, angles below SINGLE_ROUNDING are 0.
    """
    if xp is np:
        a, b = np.asarray(a, float), np.asarray(b, float)
    turn = a[..., :1] * b[..., 1:] - b[..., :1] * a[..., 1:] - xp.cross(a[..., 1:], b[..., 1:])
    # If the quaternions are equal, fused multiply-adds leave a tiny rotation about some axis.
    sine = length(turn, xp, least=0.0 if xp is np else SINGLE_ROUNDING / 2)
    return 2 * xp.arctan2(sine, xp.abs(xp.sum(a * b, axis=-1)))


def length(v: Any, xp: Any = np, *, least: float = 0.0) -> Any:
    """Return the lengths of vectors [..., n]; lengths of at most `least` are 0 with gradient 0.

    In contrast, the gradient of `jnp.linalg.norm` at zero is NaN.
    """
    square = xp.sum(v * v, axis=-1)
    # NaN must stay NaN.
    short = square <= least**2
    return xp.where(short, 0.0, xp.sqrt(xp.where(short, 1.0, square)))


def tilt_between(a: ArrayLike, b: ArrayLike) -> NDArray:
    """Return the tilt [rad] of the rotation from a to b [..., 4], that is, without its yaw."""
    turn = quat_mul(b, conjugate(a))
    return 2 * np.arctan2(
        np.hypot(turn[..., 1], turn[..., 2]), np.hypot(turn[..., 0], turn[..., 3])
    )
