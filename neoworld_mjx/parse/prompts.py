"""Requests to the reasoner and the critic of Step 1, and the schema of the critic's response."""

import math
from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from ..evidence.evidence import Evidence
from ..evidence.known_camera import KnownCamera
from ..mllm import Picture, Request, package_text
from .draw_measured import STEP_M, TOLD_SD, draw_measured
from .photo import Photo
from .schema import ParsedScene, SceneCorrection

REQUEST_PROMPT = (
    "Describe the scene in this photograph of {width} x {height} pixels: the camera, every object, "
    "every support. Give boxes in pixels of this picture."
)
KNOWN_CAMERA = (
    "\n\nThe camera was measured: {values}. Give these numbers, call them measured, and find the "
    "others, the positions and the sizes that go with them."
)
KNOWN_OBJECTS = (
    "\n\nThe user knows some of the objects: {names}. Give an object exactly this name if it is "
    "the one that the name describes."
)
MEASURED_PICTURE = (
    "\n\nThe second picture is the same photograph with measurements drawn on it. Read numbers "
    "from it, and boxes and colors from the first."
)
GROUND_GRID = (
    " Its lines are the plane z = 0, every {step:.0f} cm, bold every meter; their labels are x "
    "(ahead) and y (to the left) in meters. They are drawn over everything: read the position of "
    "an object where it touches z = 0, not where lines cross its body."
)
MEASURED_DEPTHS = (
    " Each number on white is the measured depth at the dot to its left, in meters along the view: "
    "what appears s pixels wide there at depth d is s * d / f wide."
)
REPAIR_PROMPT = (
    "{ask}\n\nYour previous response was:\n\n{response}\n\nIt was compared with the photograph and "
    "checked for consistency. These faults were found; look at the photograph again for each of "
    "them, since a finding can itself be wrong:\n\n{findings}\n\nRespond with the changes only: "
    "each object that you correct or add, complete, and the names of those that do not exist."
)
CRITIC_PROMPT = (
    "The photograph has {width} x {height} pixels. The parse lists {count} objects:"
    "\n\n{listing}\n\n{findings}Judge it."
)
FINDINGS_PROMPT = (
    "Checks of its numbers found the following. They know only boxes, not shapes:\n\n{lines}\n\n"
    "Put into `dismissed` the numbers of the findings that the photograph shows not to be "
    "faults.\n\n"
)


class SceneFault(BaseModel):
    """One fault of the parse."""

    model_config = ConfigDict(extra="forbid")

    node: str | None = Field(
        description="Name of the object; null if it is missing or the fault is of the whole scene."
    )
    kind: Literal["box", "missing", "extra", "split", "support", "relation", "hidden", "parts"]
    what: str = Field(description="What is wrong, and where you see it.")
    correction: str = Field(description="What it should be instead.")


class SceneCritique(BaseModel):
    """The critic's verdict on a parse."""

    # Titles and docstrings are part of the request: a change invalidates recorded tapes.
    model_config = ConfigDict(extra="forbid")

    faults: list[SceneFault]
    boxes: float = Field(description="Tightness of the boxes, 0 to 10.")
    completeness: float = Field(description="0 to 10.")
    hierarchy: float = Field(description="Supports, relations, hidden and moving parts, 0 to 10.")
    dismissed: list[int] = Field(
        default_factory=list,
        description="Numbers of the listed findings that the photograph shows not to be faults; "
        "empty if there are none.",
    )

    @property
    def score(self) -> float:
        """Mean of the three scores, each clipped to 0 .. 10, divided by 10."""
        scores = (self.boxes, self.completeness, self.hierarchy)
        return sum(min(max(score, 0.0), 10.0) for score in scores) / 30.0

    @property
    def lowest(self) -> float:
        """The lowest of the three scores."""
        return min(self.boxes, self.completeness, self.hierarchy)


NOTHING = Evidence()
"""Evidence of a scene of which nothing is known but its photograph."""


def parse_request(photo: Photo, evidence: Evidence = NOTHING) -> Request[ParsedScene]:
    """Return the request for the scene in a photo, with what is known of it."""
    prompt, pictures = _ask(photo, evidence)
    return Request(
        role="reasoner",
        name="parse",
        system=package_text(__package__, "reasoner"),
        prompt=prompt,
        schema=ParsedScene,
        pictures=pictures,
    )


def _ask(photo: Photo, evidence: Evidence) -> tuple[str, list[Picture]]:
    """Return the prompt and the pictures of the request for the scene in a photo."""
    width, height = photo.size
    prompt = REQUEST_PROMPT.format(width=width, height=height)
    pictures = [Picture("photo", photo.rgb)]
    known, names = evidence.camera, evidence.objects.names
    if values := [] if known is None else _known_values(known):
        prompt += KNOWN_CAMERA.format(values=", ".join(values))
    if names:
        prompt += KNOWN_OBJECTS.format(names=", ".join(names))
    measured = draw_measured(photo, known, evidence.depth)
    if measured is not None:
        prompt += MEASURED_PICTURE
        prompt += GROUND_GRID.format(step=100 * STEP_M) if measured.grid else ""
        prompt += MEASURED_DEPTHS if measured.depths else ""
        pictures.append(measured.picture)
    return prompt, pictures


def _known_values(known: KnownCamera) -> list[str]:
    """Return the known numbers of a camera by their names in the response."""
    values = []
    if known.focal is not None and known.focal_sd <= TOLD_SD:
        fovy = 2 * math.atan(known.size[1] / 2 / known.focal)
        values.append(f"fovy_deg {math.degrees(fovy):.2f}")
    for name in ("pitch", "roll"):
        if (angle := getattr(known, name)) is not None:
            values.append(f"{name}_deg {math.degrees(angle):.2f}")
    if known.height is not None:
        values.append(f"height {known.height:.4f} (of the plane z = 0 below it)")
    return values


def correction_request(
    photo: Photo,
    response: ParsedScene,
    findings: Sequence[str],
    evidence: Evidence = NOTHING,
) -> Request[SceneCorrection]:
    """Return the request for the correction of a response.

    Args:
        photo: the photograph.
        response: the response to correct.
        findings: faults of the response, each as one line.
        evidence: what is known of the scene.
    """
    ask, pictures = _ask(photo, evidence)
    prompt = REPAIR_PROMPT.format(
        ask=ask,
        response=response.model_dump_json(indent=1),
        findings="\n".join(f"- {line}" for line in findings),
    )
    return Request(
        role="reasoner",
        name="parse:mend",
        system=package_text(__package__, "reasoner"),
        prompt=prompt,
        schema=SceneCorrection,
        pictures=pictures,
    )


def critic_request(
    photo: Photo, response: ParsedScene, drawn: Picture, findings: Sequence[str] = ()
) -> Request[SceneCritique]:
    """Return the request for a critique of a response.

    Args:
        photo: the photograph.
        response: the response.
        drawn: the response drawn on the photograph.
        findings: issues found by the checks, each as one line; the critic may dismiss them by
            number.
    """
    width, height = photo.size
    lines = "\n".join(f"{number}. {line}" for number, line in enumerate(findings, start=1))
    return Request(
        role="critic",
        name="parse:judge",
        system=package_text(__package__, "critic"),
        prompt=CRITIC_PROMPT.format(
            width=width,
            height=height,
            count=len(response.objects),
            listing=listing(response),
            findings=FINDINGS_PROMPT.format(lines=lines) if findings else "",
        ),
        schema=SceneCritique,
        pictures=[Picture("photo", photo.rgb), drawn],
    )


def listing(response: ParsedScene) -> str:
    """Return a list of the response's objects for the critic, one object per line."""
    lines = []
    for obj in response.objects:
        box = obj.box
        place = "no support" if obj.parent is None else f"{obj.relation} {obj.parent}"
        if obj.parent_link is not None:
            place += f" ({obj.parent_link})"
        phrases = [
            f"{obj.name} ({obj.label}): {place}",
            f"box {box.left:.0f} {box.top:.0f} {box.right:.0f} {box.bottom:.0f}",
        ]
        if obj.environment:
            phrases.append("environment, built" if obj.furniture else "environment")
        if obj.fixed_base:
            phrases.append("fixed")
        if obj.occluded or obj.occluded_by:
            occluders = ", ".join(obj.occluded_by) or "the picture's edge"
            phrases.append(f"partly hidden by {occluders}")
        for part in obj.articulation:
            phrases.append(f"{part.part} {part.motion} at {part.opening:.0%}")
        lines.append("- " + "; ".join(phrases))
    return "\n".join(lines)
