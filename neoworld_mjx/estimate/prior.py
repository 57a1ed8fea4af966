"""Prior of the estimate: how far the scene may be from the parsed and the composed one.

The priors of objects are Student's t distributions, because most objects are almost right and some
are far off. So is that of the camera's pitch, which vertical edges can contradict.

Each pair of percentages or angles in the docstrings is the median and the 90th percentile of
changes by a weakly regularized fit of boxes. The fit was applied to the responses for four
photographs (61 objects). These values are upper bounds, because they include the error of the fit.
Standard deviations that a response states (`Cues`, `SceneTree.camera_deviations`) replace them,
within a factor of `MAX_RATIO`.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np
from jaxtyping import Float

from .unknowns import CAMERA, EACH, TILT, Placement, Unknowns

LOG_SIZE = 0.03
"""Logarithm of an object's scale: 1 %, 5 %. Sizes are the most accurate values, because the sizes
of such objects are well known."""
YAW = math.radians(3.0)
"""Heading [rad]: 0.2 deg, 2 deg, if the box depends on the heading."""
DEPTH, ACROSS = 0.035, 0.015
"""Position along and across the view, relative to the distance from the camera: together 4 %, 8 %.
The pixel of an object's foot determines the position, and one row of pixels spans more meters than
one column."""
FASTENED = 0.025
"""Position of an attached object in the plane of its support, relative to the distance from the
camera."""
PITCH, LOG_HEIGHT = math.radians(1.5), 0.04
"""Camera's pitch [rad] and logarithm of its height, which are computed from vanishing points,
ellipses and known sizes. Roll and field of view are fixed: boxes cannot distinguish a wrong field
of view from wrong distances, but vanishing points can."""


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
FALSE_EDGES = 0.15
"""Share of photographs in which the edges that look vertical are not: assumed; one of the twelve
with such edges that were looked at."""
LOG_STRETCH = 0.03
"""Standard deviation of the log stretch of a program's shape along an axis. The contours of a wrong
shape contradict one another. Without these nuisance unknowns, the layout and the camera would
absorb the contradiction."""
FIXED_YAW = 1e-4
"""Standard deviation of the heading of an object that is round or attached to a wall [rad]."""
SUPPORTED = 0.15
"""Standard deviation of the position of an object on a movable support, relative to the shorter
horizontal side of the support."""
RISE_M, LEVEL_M = 0.003, 1e-6
"""Standard deviation of the height above a support, if the height is unknown, and of an object that
is attached to a wall, whose height is another unknown, and of supports of the environment [m]."""
TAIL_SIZE, TAIL_RISE_M = 0.15, 0.02
"""Changes of a log size and of a height above a support up to which a t distribution has heavy
tails, if there is a depth image."""
MAX_RATIO = 4.0
"""Largest ratio of a standard deviation that the response states to its constant, and of the
constant to it."""
KNOWN_EDGE = 0.01
"""Standard deviation of the log size of an object with an edge of standard length."""
KNOWN = 1e-6
"""Standard deviation of an unknown whose value the user knows, in the unit of the unknown."""
LEAST_CLEARANCE_M = 0.005
"""Least standard deviation of the position of an object in a container [m]."""


def camera_deviations(
    measured: Collection[str],
    known: Mapping[str, float],
    stated: Mapping[str, float] | None = None,
    *,
    misjudged: bool,
) -> Float[np.ndarray, " 4"]:
    """Return the standard deviations of pitch and roll [rad], log focal length and log height.

    Args:
        measured: camera parameters that the response measured, as in `SceneTree.camera_measured`.
        known: standard deviations of known parameters, as `KnownCamera.deviations`.
        stated: those that the response states, as `SceneTree.camera_deviations`.
        misjudged: True if the field of view is or may be misjudged.
    """
    names = ("pitch", "roll", "fovy", "height")
    # A measured field of view is not misjudged: two whose camera is known were within .6 degrees.
    focal = LOG_FOCAL_MISJUDGED if misjudged and "fovy" not in measured else LOG_FOCAL
    deviations = np.array([PITCH, ROLL, focal, LOG_HEIGHT])
    stated = stated or {}
    deviations *= [MEASURED if name in measured and name not in stated else 1.0 for name in names]
    known_names = ("pitch", "roll", "focal", "height")
    pairs = zip(known_names, deviations.tolist(), strict=True)
    return np.array([known.get(name, stated_or(stated.get(name), sd)) for name, sd in pairs])


def stated_or(stated: float | None, constant: float) -> float:
    """Return a stated standard deviation within `MAX_RATIO` of the constant, or the constant."""
    if stated is None:
        return constant
    return min(max(stated, constant / MAX_RATIO), constant * MAX_RATIO)


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


def edges_mislead(
    residual: Float[np.ndarray, " n"],
    jacobian: Float[np.ndarray, "n 4"],
    deviations: Float[np.ndarray, " 4"],
    spans: Float[np.ndarray, " n"],
) -> bool:
    """Return whether the edges of a photograph are more probably not vertical than vertical.

    If they are vertical, the estimate by them differs from the camera by the errors of both. If
    they are not, it is anywhere in the range in which edges are searched.

    Args:
        residual: estimate by the edges minus the prior camera, in standard deviations.
        jacobian: its derivatives with respect to the unknowns of the camera.
        deviations: prior standard deviations of the camera, which is known or measured.
        spans: widths of the searched range, in standard deviations.
    """
    spread = np.eye(len(residual)) + jacobian * deviations**2 @ jacobian.T
    squared = float(residual @ np.linalg.solve(spread, residual))
    vertical = math.exp(-squared / 2) / math.sqrt(np.linalg.det(2 * math.pi * spread))
    return FALSE_EDGES / float(np.prod(spans)) > (1 - FALSE_EDGES) * vertical


def prior_precision(
    unknowns: Unknowns,
    now: Placement,
    x: Float[np.ndarray, " u"],
    deviations: Float[np.ndarray, " 4"],
    *,
    boxes_only: bool = False,
    pitch_known: bool = False,
) -> Float[np.ndarray, "v v"]:
    """Return the prior's precision matrix over the unknowns and all stretches.

    Each t distribution is approximated at `x` by a Gaussian, as in iteratively reweighted least
    squares.

    Args:
        unknowns: the unknowns.
        now: the placement at `x`.
        x: values of the unknowns, relative to the mean of the prior.
        deviations: standard deviations of the camera's unknowns.
        boxes_only: True if the scene is at the parsed places. An object on a movable support is
            then as uncertain as any other: its support may be off, too.
        pitch_known: True if the camera's pitch is not the response's.
    """
    precision = np.zeros((unknowns.size_with_stretches,) * 2)
    camera = np.arange(CAMERA)
    precision[camera, camera] = 1 / deviations**2
    if not pitch_known:
        precision[TILT, TILT] = 1 / (deviations[TILT] ** 2 + x[TILT] ** 2 / FREEDOM)
    stretches = np.arange(unknowns.size, len(precision))
    precision[stretches, stretches] = 1 / LOG_STRETCH**2
    eye = now.camera.position()
    for i, k in enumerate(unknowns.free.tolist()):
        first = CAMERA + EACH * i
        entries = x[first : first + EACH]
        distance = float(np.linalg.norm(now.pos[k] - eye))
        room = _room(unknowns, k, boxes_only=boxes_only)
        cues = unknowns.scene.objects[k].cues
        away, aside, in_wall = (
            stated_or(cues.position_sd, share * distance) for share in (DEPTH, ACROSS, FASTENED)
        )
        whitening = unknowns.view_axes(now, k) / np.minimum([away, aside], room)[:, None]
        yaw = stated_or(cues.yaw_sd, YAW)
        log_size = KNOWN_EDGE if cues.known_size else stated_or(cues.size_sd, LOG_SIZE)
        if unknowns.in_wall[k].any():
            # The two axes are along the wall and up.
            whitening = np.eye(2) / in_wall
        if unknowns.in_wall[k].any() or unknowns.round[k]:
            yaw = FIXED_YAW
        off = whitening @ entries[:2]
        xy = slice(first, first + 2)
        precision[xy, xy] = whitening.T @ whitening / (1 + off @ off / FREEDOM)
        for column, deviation in ((2, yaw), (3, log_size)):
            # A depth image shows how large an object is, and a box or a contour may be that of
            # its visible part, so no size is far from its start.
            capped = unknowns.rises or column == 3
            tail = min(abs(entries[column]), TAIL_SIZE) if capped else entries[column]
            spread = deviation**2 + tail**2 / FREEDOM
            if column == 3 and unknowns.rises and unknowns.scene.objects[k].environment:
                # The camera's height refers to its top; its outline shows another size.
                spread = LEVEL_M**2
            precision[first + column, first + column] = 1 / spread
    for k in unknowns.free.tolist():
        held = unknowns.in_wall[k].any() or unknowns.scene.objects[k].environment
        deviation = LEVEL_M if held else RISE_M
        for u in unknowns.rise_columns(k):
            precision[u, u] = 1 / (deviation**2 + min(abs(x[u]), TAIL_RISE_M) ** 2 / FREEDOM)
    for number, view in enumerate(unknowns.views, 1):
        columns = unknowns.view_columns(number)
        precision[np.ix_(columns, columns)] = view.precision
    known = list(unknowns.known)
    precision[known] = precision[:, known] = 0.0
    precision[known, known] = 1 / KNOWN**2
    return precision


def _room(unknowns: Unknowns, k: int, *, boxes_only: bool) -> float:
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
    if boxes_only or unknowns.scene.objects[parent].environment:
        return np.inf
    return SUPPORTED * side
