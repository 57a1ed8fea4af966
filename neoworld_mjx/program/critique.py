"""Requests to the critics of Step 2 (geometry, articulation, export), and their verdicts.

Requests describe the object's moving parts, its view and its tilt in the phrases of this module.
"""

import math
from collections.abc import Mapping, Sequence, Set
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from ..mllm import Picture, Request, package_text
from ..spec import Camera, JointSpec, ObjectSpec, TreeNode, bounds, inertial
from ..spec.pose import conjugate, from_yaw, quat_mul, rotate

MIN_TILT_DEG = 1.0
LIES_DEG, OVER_DEG = 60.0, 120.0
"""Tilts [deg] above which a request describes an object as lying, and as turned over."""
STEP_DEG = 5
"""Directions are rounded to multiples of this angle [deg]."""
Edge = Annotated[float, Field(gt=0, le=100)]
Edges = Annotated[list[Edge], Field(min_length=3, max_length=3)]
VIEW = (
    "direction of view: the camera stands {azimuth} from the object's front and {elevation} "
    "degrees {above} it{left}\n"
)
OPEN_PARTS = (
    ", with {parts} of the range as in the photo (draw all joints at 0, closed or off, so that, "
    "moved like that, it fills this box)"
)


class Subject(NamedTuple):
    """An object to be programmed."""

    node: TreeNode
    crop: Picture
    note: str = ""
    """Description of the parts that the crop does not show; empty if it shows the whole object."""
    camera: Camera | None = None
    """The photo's camera; if None, requests do not state the direction of view."""
    window: tuple[float, float, float, float] | None = None
    """Area of the photo that the crop shows (x0, y0, x1, y1) [px]; None if unknown."""


def moving_parts(node: TreeNode) -> str:
    """List the moving parts that the photo shows, with the types of their joints."""
    if not node.articulation:
        return "none noted"
    return ", ".join(f"{state.part} ({state.type})" for state in node.articulation)


def opened_parts(node: TreeNode) -> str:
    """Describe how far parts were moved when the box was measured; empty if none was."""
    parts = [f"{part.part} at {part.opening:.0%}" for part in node.articulation if part.opening]
    return OPEN_PARTS.format(parts=", ".join(parts)) if parts else ""


def view_in_words(node: TreeNode, camera: Camera | None) -> str:
    """Describe the photo's direction of view in the object's frame."""
    if camera is None:
        return ""
    azimuth, elevation = seen_from(node, camera)
    azimuth_deg, elevation_deg = (
        STEP_DEG * round(angle / STEP_DEG) for angle in (azimuth, elevation)
    )
    side = "to its own left" if azimuth_deg > 0 else "to its own right"
    left = ""
    if not _tilt_deg(node):
        # Beyond 45 degrees to a side the picture's left is another axis of the object.
        names = {0: "-y, its own right", 1: "+x, its front", 2: "+y, its own left"}
        left = (
            f"; the picture's left is its {names.get(round(azimuth_deg / 90) % 4, '-x, its back')}"
        )
    around = "0 degrees" if azimuth_deg == 0 else f"{abs(azimuth_deg)} degrees {side}"
    above = "below" if elevation_deg < 0 else "above"
    return VIEW.format(azimuth=around, elevation=abs(elevation_deg), above=above, left=left)


def seen_from(node: TreeNode, camera: Camera) -> tuple[float, float]:
    """Return the direction from an object to the camera, in the object's frame.

    Returns:
        The azimuth about the object's z axis [deg], which is 0 at the object's front and 90 at the
        object's left, and the elevation [deg].
    """
    x, y, z = to_camera(node, camera).tolist()
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def to_camera(node: TreeNode, camera: Camera) -> NDArray:
    """Return the vector from an object's center to the camera, in the object's frame [m]."""
    rotation = conjugate(quat_mul(from_yaw(node.box3d.yaw), np.array(node.base_tilt)))
    center = np.array(node.box3d.position) + [0, 0, node.box3d.size[2] / 2]
    return rotate(rotation, camera.position() - center)


def _tilt_deg(node: TreeNode) -> float:
    """Return an object's tilt [deg]; a tilt below MIN_TILT_DEG is returned as 0."""
    z = float(rotate(node.base_tilt, (0.0, 0.0, 1.0))[2])
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, z))))
    return 0.0 if degrees < MIN_TILT_DEG else degrees


def tilt_in_words(node: TreeNode, template: str) -> str:
    """Describe how an object leans, lies or is turned over; empty if it is upright."""
    degrees = _tilt_deg(node)
    if not degrees:
        return ""
    if degrees > 180 - MIN_TILT_DEG:
        return template.format(way="it stands upside down")
    x, y, _ = rotate(node.base_tilt, (0.0, 0.0, 1.0)).tolist()
    side = ("front" if x > 0 else "back") if abs(x) >= abs(y) else ("left" if y > 0 else "right")
    posture = "it leans" if degrees < LIES_DEG else "it lies"
    posture = "it is turned over" if degrees > OVER_DEG else posture
    return template.format(
        way=f"{posture}, tilted by {degrees:.0f} degrees, its top towards its own {side}"
    )


Score = Annotated[float, Field(ge=0, le=10)]
Decision = Literal["accept", "revise"]

_WEIGHTS = {"geometry": 0.5, "articulation": 0.3, "colour": 0.2, "masses": 0.1, "dynamics": 0.1}

# Titles, docstrings and descriptions of response schemas are part of the requests. Recorded
# responses (tapes) match only requests that are exactly equal.


class ProgramFault(BaseModel):
    """One difference between the built object and the photographed one."""

    model_config = ConfigDict(extra="forbid", title="Fault")

    part: str
    what: str
    change: str


class GeometryCritique(BaseModel):
    """The critic's verdict on geometry."""

    model_config = ConfigDict(extra="forbid", title="GeometryVerdict")

    geometry: Score
    colour: Score
    faults: list[ProgramFault] = Field(default=[], max_length=6)
    verdict: Decision
    box: Edges | None = Field(
        default=None,
        description="null if the given box can be right; otherwise the size (x, y, z) in metres "
        "that the object should have. It counts only with the verdict revise.",
    )


class ArticulationCritique(BaseModel):
    """The critic's verdict on articulation."""

    model_config = ConfigDict(extra="forbid", title="ArticulationVerdict")

    articulation: Score
    faults: list[ProgramFault] = Field(default=[], max_length=6)
    verdict: Decision


class ExportCritique(BaseModel):
    """The critic's verdict on the exported object."""

    model_config = ConfigDict(extra="forbid", title="ExportVerdict")

    masses: Score
    dynamics: Score
    faults: list[ProgramFault] = Field(default=[], max_length=6)
    verdict: Decision


Critique = GeometryCritique | ArticulationCritique | ExportCritique

CRITIQUES: dict[str, type[Critique]] = {
    "geometry": GeometryCritique,
    "articulation": ArticulationCritique,
    "export": ExportCritique,
}
"""Response schema of each critic."""

_JUDGE = """The real object: {label}. {description}
Moving parts seen in the photo: {moving}.
{posed}
{measures}
Judge it.
"""
_GEOMETRY = """The box that the program had to fill is {measured} m.
The built object measures {size} m (front to back, across, up). Its parts: {parts}."""
_ARTICULATION = """\
The built object measures {size} m (front to back, across, up). Its parts: {parts}.
Its joints:
{joints}"""
_EXPORT = """The URDF, read back, measures {size} m (front to back, across, up).
Its links:
{links}
Its joints:
{joints}"""


def critic_request(
    critic: str, node: TreeNode, spec: ObjectSpec, pictures: Sequence[Picture]
) -> Request[Any]:
    """Return the request to compare a programmed object with its parsed node.

    Args:
        critic: "geometry", "articulation" or "export".
        node: the parsed object.
        spec: the programmed object.
        pictures: the pictures that the critic's instructions name.
    """
    low, high = bounds(spec)
    links = [f"- {part.name}: {inertial(spec, part).mass:.3g} kg" for part in spec.parts]
    template = {"geometry": _GEOMETRY, "articulation": _ARTICULATION, "export": _EXPORT}[critic]
    measures = template.format(
        measured=_edges(node.box3d.size),
        size=_edges((high - low).tolist()),
        parts=", ".join(part.name for part in spec.parts),
        joints="\n".join(_joint(joint, critic == "export") for joint in spec.joints) or "none",
        links="\n".join(links),
    )
    prompt = _JUDGE.format(
        label=node.label,
        description=node.description,
        moving=moving_parts(node),
        posed=tilt_in_words(node, _posed_in({picture.label for picture in pictures})),
        measures=measures,
    )
    system = package_text(__package__, f"{critic}_critic")
    name = f"judge-{critic}:{node.name}"
    return Request("critic", name, system, prompt, CRITIQUES[critic], pictures)


def _posed_in(labels: Set[str]) -> str:
    """Return the template of the sentence that says which of these pictures show the tilt."""
    upright = [f'"{label}"' for label in ("exported", "opened") if label in labels]
    built = ', and in "made" as well' if "made" in labels else ""
    built = ", and so it does on the right" if "compared" in labels else built
    text = "In the crop {way}" + built
    if upright:
        text += f"; {' and '.join(upright)} {'show' if upright[1:] else 'shows'} it upright"
    return f"{text}.\n"


def mean_score(critiques: Mapping[str, Critique]) -> float:
    """Return the weighted mean of the critics' scores, from 0 to 10."""
    scores = {
        name: getattr(critique, name)
        for critique in critiques.values()
        for name in _WEIGHTS
        if hasattr(critique, name)
    }
    total = sum(_WEIGHTS[name] for name in scores)
    return sum(_WEIGHTS[name] * score for name, score in scores.items()) / total


def accepts(critique: Critique) -> bool:
    """Return True if the critic's verdict is "accept", or if it requests no change."""
    return critique.verdict == "accept" or not (critique.faults or corrected_box(critique))


def corrected_box(critique: Critique) -> list[float] | None:
    """Return the edges [m] of the box that the critic corrected; None without a correction."""
    return critique.box if isinstance(critique, GeometryCritique) else None


def _edges(edges: Sequence[float]) -> str:
    return " by ".join(f"{edge:.3f}" for edge in edges)


def _joint(joint: JointSpec, dynamics: bool) -> str:
    unit, effort = ("m", "N") if joint.type == "prismatic" else ("rad", "N m")
    text = f"- {joint.name}: {joint.type}, {joint.child} on {joint.parent}"
    if joint.type in ("revolute", "prismatic"):
        text += f", {joint.lower:.3g} to {joint.upper:.3g} {unit}"
    if dynamics and joint.type != "fixed":
        text += f", damping {joint.damping:.3g}, friction {joint.friction:.3g} {effort}"
        text += "" if joint.effort is None else f", effort {joint.effort:.3g} {effort}"
    return text
