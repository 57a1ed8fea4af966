"""Requests of Step 3 to models (3.2): the critic judges key frames, and the reasoner edits.

The critic returns one of three verdicts:

- "edit": the reasoner proposes a `Patch`, which is accepted only if it lowers the fault score.
- "reprogram": the programmer writes the program again, which is accepted only if it lowers the
  fault score.
- "sound": checks that fail only because the object is tested without its scene are waived.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..checks.object_tests import ObjectTests
from ..checks.support_polygon import support_polygon
from ..mllm import Request, package_text
from ..spec import PartSpec, bounds, inertial, pieces
from ..spec.convex import box_around
from .key_frames import questionable, strips
from .patch import Patch

# Titles, docstrings and descriptions of response schemas are part of the requests. Recorded
# responses (tapes) match only requests that are exactly equal.


class Finding(BaseModel):
    """One observation in the key frames."""

    model_config = ConfigDict(extra="forbid")

    where: Annotated[str, Field(max_length=60)]
    """Part or joint."""
    what: Annotated[str, Field(max_length=400)]
    suggestion: Annotated[str, Field(max_length=400)] = ""


class MotionCritique(BaseModel):
    """The critic's verdict on an object's motion."""

    model_config = ConfigDict(extra="forbid", title="MotionVerdict")

    findings: list[Finding] = Field(default=[], max_length=6)
    verdict: Literal["sound", "edit", "reprogram"]


class ProposedEdit(BaseModel):
    """The reasoner's edit of an object."""

    model_config = ConfigDict(extra="forbid", title="Edit")

    patch: Patch
    why: Annotated[str, Field(max_length=600)] = ""


def key_frames_request(
    tests: ObjectTests,
    *,
    surroundings: str = "",
    tried: Sequence[str] = (),
    always: bool = False,
) -> Request[MotionCritique]:
    """Return the request to the critic to judge an object's key frames.

    Args:
        tests: results of the object tests.
        surroundings: a sentence that says what the object stands on or in.
        tried: changes that models proposed before, with their outcomes.
        always: if True, add the standard scenarios; see `strips`.
    """
    paragraphs = [
        f"The object: {tests.spec.label or tests.spec.name}. {surroundings}".rstrip(),
        _numbers(tests),
        _listed("Tried before", tried) if tried else "",
    ]
    prompt = "\n\n".join(filter(None, paragraphs))
    name, frames = f"simulation:{tests.spec.name}", strips(tests, include_standard=always)
    return Request("critic", name, _instructions("critic"), prompt, MotionCritique, frames)


def edit_request(
    tests: ObjectTests,
    critique: MotionCritique,
    *,
    surroundings: str = "",
    tried: Sequence[str] = (),
) -> Request[ProposedEdit]:
    """Return the request to the reasoner for a patch.

    Args:
        tests: results of the object tests.
        critique: the critic's critique, whose findings the request lists.
        surroundings: a sentence that says what the object stands on or in.
        tried: changes that models proposed before, with their outcomes.
    """
    paragraphs = [
        surroundings,
        _numbers(tests),
        _listed("The critic's findings", findings(critique)),
        _listed("Edits that were dropped or did not suffice", tried) if tried else "",
        f"The object:\n{described(tests)}",
    ]
    prompt = "\n\n".join(filter(None, paragraphs))
    name = f"edit:{tests.spec.name}"
    return Request("reasoner", name, _instructions("editor"), prompt, ProposedEdit)


def findings(critique: MotionCritique) -> list[str]:
    """Return the findings of a critique, one line each."""
    return [
        f"{f.where}: {f.what}" + (f" -> {f.suggestion}" if f.suggestion else "")
        for f in critique.findings
    ]


def _instructions(name: str) -> str:
    return package_text(__package__, name).removesuffix("\n")


def _listed(title: str, lines: Sequence[str]) -> str:
    return f"{title}:\n" + "\n".join(f"- {line}" for line in lines or ("none",))


def _numbers(tests: ObjectTests) -> str:
    lines = []
    for check in questionable(tests.verdict):
        outcome = "BARELY PASSED" if check.borderline else check.outcome
        evidence = f" ({check.evidence})" if check.evidence else ""
        lines.append(f"{outcome} {check.scenario} {check.phrase()}{evidence}")
    return _listed("Values that failed or barely passed", lines)


def described(tests: ObjectTests) -> str:
    """Describe an object's extent and base, and the current values that a patch can edit."""
    spec = tests.spec
    low, high = bounds(spec)
    lines = [f"extent: {_ranges(low, high)}; the origin is (0, 0, 0)"]
    if tests.simulation is not None:
        width, margin = support_polygon(tests.simulation)
        place = (
            f"{1e3 * margin:.1f} mm within it" if margin >= 0 else f"{-1e3 * margin:.1f} mm outside"
        )
        mass = sum(inertial(spec, part).mass for part in spec.parts)
        lines.append(
            f"base: its contact with a level floor is {1e3 * width:.1f} mm wide; the centre of "
            f"mass is {place}; {mass:.4g} kg in all"
        )
    for material in spec.materials:
        lines.append(f"material {material.name}: friction {material.friction:.3g}")
    for part in spec.parts:
        inertia = inertial(spec, part)
        x, y, z = inertia.pos
        lines.append(f"part {part.name}: {inertia.mass:.4g} kg, centre ({x:.3f}, {y:.3f}, {z:.3f})")
        lines += _geom_lines(part)
    for j in spec.joints:
        x, y, z = j.pos
        lines.append(
            f"joint {j.name}: {j.type}, {j.child} on {j.parent}, at ({x:.3f}, {y:.3f}, {z:.3f}) "
            f"along {tuple(round(v, 3) for v in j.axis)}, {j.lower:.4g} to {j.upper:.4g}, damping "
            f"{j.damping:.4g}, friction {j.friction:.4g}"
        )
    return "\n".join(lines)


def _geom_lines(part: PartSpec) -> list[str]:
    """Describe the first 12 geoms of a part, with their extents."""
    boxes: dict[str, list[np.ndarray]] = {}
    for role in ("collision", "visual"):
        for geom, piece, frame in pieces(part, role):
            boxes.setdefault(geom.name, []).append(np.array(box_around(piece, frame)))
    lines = []
    for geom in part.geoms[:12]:
        ends = np.array(boxes[geom.name]) if geom.name in boxes else np.zeros((1, 2, 3))
        lines.append(
            f"  geom {geom.name}: {geom.shape.type}, {geom.role}, {geom.material}, "
            f"{_ranges(ends[:, 0].min(axis=0), ends[:, 1].max(axis=0))}"
        )
    return lines


def _ranges(low: np.ndarray, high: np.ndarray) -> str:
    axes = zip("xyz", low, high, strict=True)
    return ", ".join(f"{axis} {a + 0.0:.3f} to {b + 0.0:.3f}" for axis, a, b in axes)
