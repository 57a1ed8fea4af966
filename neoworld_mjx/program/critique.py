"""Requests to the critics of Step 2 (geometry, articulation, export), and their verdicts."""

from collections.abc import Mapping, Sequence, Set
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from ..mllm import Picture, Request, package_text
from ..spec import JointSpec, ObjectSpec, TreeNode, bounds, inertial
from .subject import Edges, moving_parts, tilt_in_words

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
        description="null if the measured box can be right; otherwise the size (x, y, z) in metres "
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
_GEOMETRY = """The box measured in the photo is {measured} m.
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
        pictures: the crop, and the other pictures that the critic's instructions name.
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
    text = "In the crop {way}" + (', and in "made" as well' if "made" in labels else "")
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
