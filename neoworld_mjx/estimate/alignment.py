"""Result of the alignment: the aligned scene, its changes, and their uncertainty.

Prior of the alignment: how far the composed scene may be from the photographed one.

Most standard deviations are those of the fit (`priors`), which placed the objects. The priors
of objects are Student's t distributions, because most objects are almost right and some are far
off. So is that of the camera's pitch, which vertical edges can contradict.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..spec import Camera, SceneSpec
from ..spec.scene import PoseUncertainty
from .camera_evidence import CameraEstimate
from .priors import ACROSS, DEPTH, FASTENED, LOG_HEIGHT, LOG_SIZE, PITCH, YAW
from .unknowns import CAMERA, EACH, TILT, Placement, Unknowns

NOTED_M, NOTED_SIZE, NOTED_DEG = 0.05, 0.10, 10.0
"""Changes of position [m], size (relative) and heading [deg] above which a note reports them."""
NOTED_VIEW_DEG, NOTED_HEIGHT = 2.0, 0.05
"""Changes of the camera's angles [deg] and height (relative) above which a note reports them."""

EvidenceKind = Literal["pixels", "box", "none"]
"""Evidence of an object's pose: its contour in the pixels, its 2D box, or none."""


@dataclass(frozen=True)
class DepthOutcome:
    """Depths of one object before and after the alignment."""

    pixels: int
    """Number of pixels that were used."""
    before_m: float
    """Median absolute residual before the alignment [m]."""
    after_m: float
    """Median absolute residual after the alignment [m]."""
    rise_m: float
    """Height above its support that the depths indicate [m]."""
    refused: str
    """Reason why the depths are not used; empty if they are."""


@dataclass(frozen=True)
class ObjectAlignment:
    """Change of one object by the alignment."""

    evidence: EvidenceKind
    reason: str
    """Reason why contours do not determine the object's pose; empty if they do."""
    shift_m: tuple[float, float]
    """Change of the position in the frame of the object's support [m]; for an object attached to a
    wall, along the wall and up."""
    yaw_deg: float
    size_ratio: float
    uncertainty: PoseUncertainty
    depth: DepthOutcome | None = None
    """Result of the depth image; None if there is none."""


@dataclass(frozen=True)
class ViewOutcome:
    """Outcome of a further photograph in the alignment."""

    objects: int
    """Number of objects in it whose boxes are known."""
    camera: Camera | None
    """Its camera, in the frame of the aligned scene; None if the photograph is not used."""
    turn_deg: float = 0.0
    """Angle at the middle of the scene between the two cameras."""
    reason: str = ""
    """Reason why the photograph is not used; empty if it is."""

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as JSON data."""
        camera = None if self.camera is None else self.camera.model_dump(mode="json")
        values = {"objects": self.objects, "turn_deg": round(self.turn_deg, 2)}
        return {**values, "camera": camera, "reason": self.reason}


@dataclass(frozen=True)
class FittedUnknowns:
    """Unknowns of an alignment, and their estimated values."""

    unknowns: Unknowns
    x: Float[np.ndarray, " u"]


@dataclass(frozen=True)
class Alignment:
    """Result of `align`."""

    scene: SceneSpec
    """The aligned scene, with its camera and each object's uncertainty."""
    pitch_deg: float = 0.0
    """Change of the camera's pitch; the next three fields are the changes of its other
    parameters."""
    roll_deg: float = 0.0
    fovy_deg: float = 0.0
    height_m: float = 0.0
    objects: dict[str, ObjectAlignment] = field(default_factory=dict)
    camera: dict[str, CameraEstimate] = field(default_factory=dict)
    """Parameters of the camera, by their names in `Camera`; empty if nothing was aligned."""
    failure: str = ""
    """Reason why the alignment failed, in which case `scene` is the composed scene; empty if it did
    not fail."""
    views: dict[str, ViewOutcome] = field(default_factory=dict)
    """Further photographs, by their names."""
    fitted: FittedUnknowns | None = field(default=None, repr=False, compare=False)
    """Unknowns and their estimates; None if there were no unknowns or if the solver failed."""

    def notes(
        self, before: SceneSpec, start: str = "composed", cause: str = "the photograph"
    ) -> Iterator[tuple[str, str]]:
        """Yield a note, as a title and a text, for each large change of the camera or an object.

        Args:
            before: the scene before the alignment.
            start: the poses in it.
            cause: what changed them.
        """
        camera = before.camera
        turned = max(abs(self.pitch_deg), abs(self.roll_deg), abs(self.fovy_deg))
        if camera is not None and (
            turned > NOTED_VIEW_DEG or abs(self.height_m) > NOTED_HEIGHT * abs(camera.height)
        ):
            yield (
                "a camera that differs from the response's",
                f"{cause} turned it by {self.pitch_deg:+.1f} deg in pitch and "
                f"{self.roll_deg:+.1f} deg in roll, changed its field of view by "
                f"{self.fovy_deg:+.1f} deg and its height by {100 * self.height_m:+.0f} cm",
            )
        for name, change in self.objects.items():
            distance = math.hypot(*change.shift_m)
            if (
                distance > NOTED_M
                or abs(change.size_ratio - 1) > NOTED_SIZE
                or abs(change.yaw_deg) > NOTED_DEG
            ):
                degrees = round(change.yaw_deg)  # An integer is never written as "-0".
                yield (
                    f"{name} far from its {start} pose",
                    f"{cause} moved it by {100 * distance:.1f} cm, scaled it by "
                    f"{change.size_ratio:.2f} and turned it by {degrees:+d} deg",
                )
        for name, view in self.views.items():
            if not view.reason:
                what = f"it shows {view.objects} objects from {view.turn_deg:.0f} deg aside"
                yield f"{name} is used for the layout", what

    def to_json(self) -> dict[str, Any]:
        """Return the changes as JSON data, without the scene."""
        camera = ("pitch_deg", "roll_deg", "fovy_deg", "height_m")
        return {
            **{name: round(getattr(self, name), 5) for name in camera},
            "camera": {name: _rounded(asdict(estimate)) for name, estimate in self.camera.items()},
            "objects": {
                name: {
                    "evidence": change.evidence,
                    "reason": change.reason,
                    "shift_m": [round(x, 5) for x in change.shift_m],
                    "yaw_deg": round(change.yaw_deg, 3),
                    "size_ratio": round(change.size_ratio, 5),
                    "uncertainty": change.uncertainty.model_dump(mode="json"),
                    **({} if change.depth is None else {"depth": _rounded(asdict(change.depth))}),
                }
                for name, change in self.objects.items()
            },
            **({"views": {n: v.to_json() for n, v in self.views.items()}} if self.views else {}),
        }


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values, with numbers rounded to six decimals."""
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in values.items()}


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
KNOWN = 1e-6
"""Standard deviation of an unknown whose value the user knows, in the unit of the unknown."""
LEAST_CLEARANCE_M = 0.005
"""Least standard deviation of the position of an object in a container [m]."""


def camera_deviations(
    measured: Collection[str], known: Mapping[str, float], *, misjudged: bool
) -> Float[np.ndarray, " 4"]:
    """Return the standard deviations of pitch and roll [rad], log focal length and log height.

    Args:
        measured: camera parameters that the response measured, as in `SceneTree.camera_measured`.
        known: standard deviations of known parameters, as `KnownCamera.deviations`.
        misjudged: True if the field of view is or may be misjudged.
    """
    names = ("pitch", "roll", "fovy", "height")
    deviations = np.array(
        [PITCH, ROLL, LOG_FOCAL_MISJUDGED if misjudged else LOG_FOCAL, LOG_HEIGHT]
    )
    deviations *= [MEASURED if name in measured else 1.0 for name in names]
    known_names = ("pitch", "roll", "focal", "height")
    pairs = zip(known_names, deviations.tolist(), strict=True)
    return np.array([known.get(name, deviation) for name, deviation in pairs])


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
    *,
    boxes_only: bool = False,
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
    """
    precision = np.zeros((unknowns.size_with_stretches,) * 2)
    camera = np.arange(CAMERA)
    precision[camera, camera] = 1 / deviations**2
    if deviations[TILT] >= MEASURED * PITCH:  # The pitch is a model's, and not known.
        precision[TILT, TILT] = 1 / (deviations[TILT] ** 2 + x[TILT] ** 2 / FREEDOM)
    stretches = np.arange(unknowns.size, len(precision))
    precision[stretches, stretches] = 1 / LOG_STRETCH**2
    eye = now.camera.position()
    for i, k in enumerate(unknowns.free.tolist()):
        first = CAMERA + EACH * i
        entries = x[first : first + EACH]
        distance = float(np.linalg.norm(now.pos[k] - eye))
        room = _room(unknowns, k, boxes_only=boxes_only)
        most = np.minimum(np.array([DEPTH, ACROSS]) * distance, room)
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
