"""Result of the estimate: the aligned scene, its changes, and their uncertainty."""

import math
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..spec import Camera, SceneSpec
from ..spec.scene import PoseUncertainty
from .rows.edges import ESTIMATED, MEASURED, CameraEstimate
from .unknowns import Unknowns

NOTED_M, NOTED_SIZE, NOTED_DEG = 0.05, 0.10, 10.0
"""Changes of position [m], size (relative) and heading [deg] above which a note reports them."""
NOTED_VIEW_DEG, NOTED_HEIGHT = 1.0, 0.03
"""Changes of the camera's angles [deg] and height (relative) above which `camera_change` reports
them."""

EvidenceKind = Literal["pixels", "box", "none"]
"""Evidence of an object's pose: its contour in the pixels, its 2D box, or none."""
EVIDENCE_NAMES = {"pixels": "contours", "box": "2D boxes"}


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
    misleading_edges: bool = False
    """True if edges that look vertical contradict the camera and are probably not vertical."""
    views: dict[str, ViewOutcome] = field(default_factory=dict)
    """Further photographs, by their names."""
    fitted: FittedUnknowns | None = field(default=None, repr=False, compare=False)
    """Unknowns and their estimates; None if there were no unknowns or if the solver failed."""

    def notes(
        self, start: str = "composed", cause: str = "the photograph"
    ) -> Iterator[tuple[str, str]]:
        """Yield a note, as a title and a text, for each large change of an object.

        Args:
            start: the poses before the alignment.
            cause: what changed them.
        """
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
        if self.misleading_edges:
            yield "edges that look vertical are not used", "the camera contradicts them"
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


def camera_change(before: Camera, after: Camera, alignments: Collection[Alignment]) -> str:
    """Return what became of a response's camera, and from what; empty if it hardly changed.

    Known parameters are left out.

    Args:
        before: the camera of the response.
        after: the camera of the scene.
        alignments: the alignments between them.
    """
    estimates = {name: e.source for done in alignments for name, e in done.camera.items()}
    changes, sources = [], dict[str, None]()
    for name, title in (("fovy", "field of view"), ("pitch", "pitch"), ("roll", "roll")):
        start, end = (math.degrees(getattr(camera, name)) for camera in (before, after))
        if abs(end - start) > NOTED_VIEW_DEG and estimates.get(name, "").startswith(ESTIMATED):
            changes.append((name, f"{title} {start:.1f} -> {end:.1f} degrees"))
    if abs(after.height - before.height) > NOTED_HEIGHT * abs(before.height) and estimates.get(
        "height", ""
    ).startswith(ESTIMATED):
        changes.append(("height", f"height {before.height:.2f} -> {after.height:.2f} m"))
    for name, _ in changes:
        phrases = estimates[name].removeprefix(ESTIMATED).removeprefix(": ")
        # What the response measured is where the estimate started.
        sources |= {phrase: None for phrase in phrases.split(", ") if phrase not in ("", MEASURED)}
    kinds = {change.evidence for done in alignments for change in done.objects.values()}
    sources |= dict.fromkeys(EVIDENCE_NAMES[kind] for kind in EVIDENCE_NAMES if kind in kinds)
    said = ", ".join(text for _, text in changes)
    return f"{said} (estimated from: {', '.join(sources)})" if changes else ""


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values, with numbers rounded to six decimals."""
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in values.items()}
