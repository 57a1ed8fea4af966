"""Result of the alignment: the scene, what changed, and how much the photograph says about it."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..spec import SceneSpec
from ..spec.scene import PoseUncertainty
from .shape_evidence import ShapeEvidence
from .unknowns import Unknowns

NOTED_M, NOTED_SIZE, NOTED_DEG = 0.05, 0.10, 10.0
"""Changes of position, size and heading above which a note reports them."""
NOTED_VIEW_DEG, NOTED_HEIGHT = 2.0, 0.05
"""Changes of the camera's angles and, relatively, of its height above which a note reports them."""

Evidence = Literal["pixels", "box", "none"]
"""Source of an object's place: its contour in the pixels, its 2D box, or the composition."""


@dataclass(frozen=True)
class JointAlignment:
    """Change of one open joint by the alignment; units are rad of hinges and m of slides."""

    slides: bool
    value: float
    """Position after the alignment."""
    change: float
    """Increase of its distance from 0 over the composed position, in the same unit."""
    deviation: float
    """Standard deviation of the position."""

    @property
    def is_far(self) -> bool:
        """True if a note reports the change."""
        return abs(self.change) > (NOTED_M if self.slides else math.radians(NOTED_DEG))

    def phrase(self) -> str:
        """Return how far the joint is open, and how much that differs from the composition."""
        text = lambda x: f"{100 * x:.1f} cm" if self.slides else f"{math.degrees(x):.0f} deg"
        more = "more" if self.change > 0 else "less"
        by = f"{text(abs(self.change))} {more} than composed" if self.change else "as composed"
        return f"opens {text(abs(self.value))}, {by} (± {text(self.deviation)})"


@dataclass(frozen=True)
class ObjectAlignment:
    """Change of one object by the alignment."""

    evidence: Evidence
    reason: str
    """Why the pixels do not place the object; empty if they do."""
    shift_m: tuple[float, float]
    """Change of the position in its support's frame."""
    yaw_deg: float
    size_ratio: float
    uncertainty: PoseUncertainty
    joints: dict[str, JointAlignment] = field(default_factory=dict)
    """Of joints that are seen open."""


@dataclass(frozen=True)
class FittedUnknowns:
    """Unknowns of an alignment at their estimate."""

    unknowns: Unknowns
    x: Float[np.ndarray, " u"]
    shapes: dict[int, ShapeEvidence]
    """Evidence of contours about the proportions of objects; those that the pixels do not place
    are missing."""


@dataclass(frozen=True)
class DimensionEdit:
    """Change of a named constant of an object's program."""

    constant: str
    before: float
    after: float


@dataclass(frozen=True)
class FreedObject:
    """Changes of the dimensions of an object's program."""

    edits: tuple[DimensionEdit, ...]
    reason: str = ""
    """Why there are none; empty if there are."""
    outline_before_px: float | None = None
    """Distance of its outline from the photograph's before and after; see `outline_errors`."""
    outline_after_px: float | None = None

    def phrase(self) -> str:
        """Return the changes in one line."""
        edits = [f"{e.constant} {e.before:.4g} -> {e.after:.4g}" for e in self.edits]
        if self.outline_before_px is not None and self.outline_after_px is not None:
            px = self.outline_before_px, self.outline_after_px
            edits.append("outline {:.1f} -> {:.1f} px".format(*px))
        return ", ".join(edits)


@dataclass(frozen=True)
class Alignment:
    """Result of `align`."""

    scene: SceneSpec
    """The scene with its camera, aligned; objects have their uncertainty."""
    pitch_deg: float = 0.0
    """Changes of the camera."""
    roll_deg: float = 0.0
    fovy_deg: float = 0.0
    height_m: float = 0.0
    objects: dict[str, ObjectAlignment] = field(default_factory=dict)
    failure: str = ""
    """Reason why the scene was not aligned and is as composed; empty if it was."""
    dimensions: dict[str, FreedObject] = field(default_factory=dict)
    """Changes of programs by object; empty unless `compose.align.dimensions` is set."""
    fitted: FittedUnknowns | None = field(default=None, repr=False, compare=False)
    """The unknowns; None if there were none or the solver failed."""

    def notes(self, before: SceneSpec) -> Iterator[tuple[str, str]]:
        """Yield a note for the camera, and for each object or joint that moved far.

        Args:
            before: the composed scene.
        """
        camera = before.camera
        turned = max(abs(self.pitch_deg), abs(self.roll_deg), abs(self.fovy_deg))
        if camera is not None and (
            turned > NOTED_VIEW_DEG or abs(self.height_m) > NOTED_HEIGHT * abs(camera.height)
        ):
            yield (
                "a camera that differs from the response's",
                f"the photograph's contours turned it by {self.pitch_deg:+.1f} deg in pitch and "
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
                degrees = round(change.yaw_deg)  # An integer, as "-0" has no direction.
                yield (
                    f"{name} far from its composed pose",
                    f"the photograph moved it by {100 * distance:.1f} cm, scaled it by "
                    f"{change.size_ratio:.2f} and turned it by {degrees:+d} deg",
                )
            for joint, opening in change.joints.items():
                if opening.is_far:
                    phrase = f"in the photograph joint {joint} {opening.phrase()}"
                    yield f"{name} open otherwise than composed", phrase
        for name, freed in self.dimensions.items():
            if freed.edits:
                yield f"{name} has other dimensions than its program", freed.phrase()

    def to_json(self) -> dict[str, Any]:
        """Return JSON data, without the scene."""
        camera = ("pitch_deg", "roll_deg", "fovy_deg", "height_m")
        return {
            **{name: round(getattr(self, name), 5) for name in camera},
            "objects": {
                name: {
                    "evidence": change.evidence,
                    "reason": change.reason,
                    "shift_m": [round(x, 5) for x in change.shift_m],
                    "yaw_deg": round(change.yaw_deg, 3),
                    "size_ratio": round(change.size_ratio, 5),
                    "uncertainty": change.uncertainty.model_dump(mode="json"),
                    **_joints(change.joints),
                }
                for name, change in self.objects.items()
            },
            **({"dimensions": self._dimensions()} if self.dimensions else {}),
        }

    def _dimensions(self) -> dict[str, Any]:
        return {
            name: asdict(freed) | {"phrase": freed.phrase()}
            for name, freed in self.dimensions.items()
        }


def _joints(joints: dict[str, JointAlignment]) -> dict[str, Any]:
    """Return the JSON data of open joints, none without any."""
    data = {
        name: {
            "value": round(joint.value, 5),
            "change": round(joint.change, 5),
            "deviation": round(joint.deviation, 5),
            "phrase": joint.phrase(),
        }
        for name, joint in joints.items()
    }
    return {"joints": data} if data else {}
