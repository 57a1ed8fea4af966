"""Prior of the alignment: how far the composed scene may be from the photographed one.

Most standard deviations are those of the fit (`fit.priors`), which placed the objects. The priors
of objects and joints are Student's t distributions, because most objects are almost right and some
are far off. So is that of the camera's pitch, which vertical edges can contradict.
"""

import math
from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from ..fit.priors import ACROSS, DEPTH, FASTENED, LOG_HEIGHT, LOG_SIZE, PITCH, YAW
from .open_joints import OpenJoint
from .placement import Placement
from .unknowns import CAMERA, EACH, STRETCH, TILT, Unknowns

FREEDOM = 4.0
"""Degrees of freedom of the t distributions."""
ROLL = np.radians(1.0)
"""Standard deviation of the camera's roll [rad]."""
LOG_FOCAL, LOG_FOCAL_MISJUDGED = 0.04, 0.2
"""Standard deviation of the log focal length if the field of view is not misjudged, and if it
is."""
MISJUDGED = 0.4
"""Share of responses that misjudge the field of view; two of five responses to rendered images
did."""
MEASURED = 0.5
"""Factor that multiplies the standard deviations of camera parameters that the response
measured."""
LOG_STRETCH = 0.03
"""Standard deviation of the log stretch of a program's shape along an axis. The contours of a wrong
shape contradict one another. Without these nuisance unknowns, the layout and the camera would
absorb the contradiction."""
LOG_PART_STRETCH = 0.06
"""Standard deviation of the log stretch of the parts that a hinge moves: a change of a door's
length changes the image as a change of its angle does."""
FIXED_YAW = 1e-4
"""Standard deviation of the heading of an object that is round or attached to a wall [rad]."""
SUPPORTED = 0.15
"""Standard deviation of the position of an object on a movable support, relative to the shorter
horizontal side of the support."""
OPENING = 0.06
"""Standard deviation of a joint's opening, relative to the joint's range. The response estimates
the opening from a ratio of two lengths in the image."""
RANGE = 0.26
"""Standard deviation of the log range of a joint in a program. The parsed opening is a share of
this range."""
LEAST_CLEARANCE_M = 0.005
"""Least standard deviation of the position of an object in a container [m]."""


def camera_deviations(measured: Collection[str], *, misjudged: bool) -> Float[np.ndarray, " 4"]:
    """Return the standard deviations of pitch and roll [rad], log focal length and log height.

    Args:
        measured: camera parameters that the response measured, as in `SceneTree.camera_measured`.
        misjudged: True if the field of view is or may be misjudged.
    """
    names = ("pitch", "roll", "fovy", "height")
    deviations = np.array(
        [PITCH, ROLL, LOG_FOCAL_MISJUDGED if misjudged else LOG_FOCAL, LOG_HEIGHT]
    )
    return deviations * [MEASURED if name in measured else 1.0 for name in names]


def is_misjudged(log_focal: float, deviation: float) -> bool:
    """Return whether a field of view is more probably misjudged than not.

    The prior of the log focal length is a mixture of two Gaussians. The wider one has the weight
    MISJUDGED.

    Args:
        log_focal: estimate of the log focal length with the wide prior, minus the value of the
            response.
        deviation: standard deviation of the estimate.
    """
    log_odds = math.log(MISJUDGED / (1 - MISJUDGED))
    for sign, width in ((1, LOG_FOCAL_MISJUDGED), (-1, LOG_FOCAL)):
        variance = width**2 + deviation**2
        log_odds -= sign * (math.log(variance) + log_focal**2 / variance) / 2
    return log_odds > 0


def prior_precision(
    unknowns: Unknowns,
    now: Placement,
    x: Float[np.ndarray, " u"],
    deviations: Float[np.ndarray, " 4"],
) -> Float[np.ndarray, "v v"]:
    """Return the prior's precision matrix over the unknowns and all stretches.

    Each t distribution is approximated at `x` by a Gaussian, as in iteratively reweighted least
    squares.


    Args:
        unknowns: the unknowns.
        now: the placement at `x`.
        x: values of the unknowns.
        deviations: standard deviations of the camera's unknowns.
    """
    precision = np.zeros((unknowns.size_with_stretches,) * 2)
    camera = np.arange(CAMERA)
    precision[camera, camera] = 1 / deviations**2
    precision[TILT, TILT] = 1 / (deviations[TILT] ** 2 + x[TILT] ** 2 / FREEDOM)
    stretches = np.arange(unknowns.size, len(precision))
    precision[stretches, stretches] = 1 / LOG_STRETCH**2
    of_parts = stretches[STRETCH * len(unknowns.free) :]
    precision[of_parts, of_parts] = 1 / LOG_PART_STRETCH**2
    eye = now.camera.position()
    for i, k in enumerate(unknowns.free.tolist()):
        first = CAMERA + EACH * i
        entries = x[first : first + EACH]
        distance = float(np.linalg.norm(now.pos[k] - eye))
        most = np.minimum(np.array([DEPTH, ACROSS]) * distance, _room(unknowns, k))
        whitening = unknowns.view_axes(now, k) / most[:, None]
        yaw = YAW
        if unknowns.in_wall[k].any():
            # The two axes are along the wall and up.
            whitening = np.eye(2) / (FASTENED * distance)
        if unknowns.in_wall[k].any() or unknowns.round[k]:
            yaw = FIXED_YAW
        off = whitening @ entries[:2]
        xy = slice(first, first + 2)
        precision[xy, xy] = whitening.T @ whitening / (1 + off @ off / FREEDOM)
        for column, deviation in ((2, yaw), (3, LOG_SIZE)):
            spread = deviation**2 + entries[column] ** 2 / FREEDOM
            precision[first + column, first + column] = 1 / spread
    for u, joint in enumerate(unknowns.joints, unknowns.first_joint):
        spread = opening_deviation(joint) ** 2 + x[u] ** 2 / FREEDOM
        precision[u, u] = 1 / spread
    return precision


def opening_deviation(joint: OpenJoint) -> float:
    """Return the standard deviation of the composed position of an open joint [rad or m]."""
    share, open_by = OPENING * (joint.upper - joint.lower), RANGE * (joint.value - joint.closed)
    return math.hypot(share, open_by)


def _room(unknowns: Unknowns, k: int) -> float:
    """Return the largest standard deviation [m] of a position that an object's support allows.

    For an object in a container, it is half the clearance. For an object on a movable support, it
    is SUPPORTED times the shorter horizontal side of the support. Otherwise, it is infinite.
    """
    item = unknowns.scene.objects[k]
    if item.parent is None or item.relation not in ("in", "on"):
        return np.inf
    parent = unknowns.scene.index(item.parent)
    side = float(unknowns.shorter_side[parent])
    if item.relation == "in":
        return max((side - float(unknowns.shorter_side[k])) / 2, LEAST_CLEARANCE_M)
    return np.inf if unknowns.scene.objects[parent].environment else SUPPORTED * side
