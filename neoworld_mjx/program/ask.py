"""Requests about an object: write its program, repair it, judge pictures of it; their schemas."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from ..config import ProgramOptions
from ..mllm import Picture, Request, package_text
from ..spec import TreeNode
from ..spec.pose import rotate
from .signals import Signal

MIN_TILT_DEG = 1.0
Score = Annotated[float, Field(ge=0, le=10)]


# Titles, docstrings and descriptions of the answers are part of the requests: tapes hold answers to
# these very ones.


class ProgramAnswer(BaseModel):
    """The programmer's answer."""

    model_config = ConfigDict(extra="forbid", title="Written")

    program: str = Field(description="The whole program, plain Python text, without code fences.")
    notes: str = Field(default="", description="What was guessed or could not be seen, briefly.")
    removed: list[str] = Field(
        default=[],
        description="Names of parts and joints of the earlier program that this one leaves out on "
        "purpose; else empty.",
    )


class ProgramFault(BaseModel):
    """One difference between the made object and the photographed one."""

    model_config = ConfigDict(extra="forbid", title="Fault")

    part: str
    what: str
    change: str


class ProgramCritique(BaseModel):
    """The critic's answer."""

    model_config = ConfigDict(extra="forbid", title="Verdict")

    geometry: Score
    articulation: Score
    colour: Score
    faults: list[ProgramFault] = Field(default=[], max_length=6)
    verdict: Literal["accept", "revise"]


ASK = """Write the program of this object.

name: {name}
what it is: {label}
described as: {description}
measured box{opened}: {x:.3f} m (x, front to back) by {y:.3f} m (y) by {z:.3f} m (z, up)
moving parts seen: {moving}
{posed}{seen}
The picture "crop" is cut out of the photo around the object; \
grey frames in it mark neighbours, which are
no part of it.
"""
OPENED = (
    ", with {parts} as in the photo (draw it closed, so that opened like that it fills this box)"
)
TILTED = (
    "In the photo it is turned over: {way}. Box and axes are those of the thing as it stands: draw "
    "it upright.\n"
)
HIDDEN = "In the crop it is {note}: complete it as such things are."
WHOLE = "It is seen whole, without anything in front of it."
MEND = """{ask}
This is the program so far:

```python
{program}
```

{heading}

{findings}

Write the whole program again, mended. Keep every part and joint that was right. \
If you leave one out on
purpose, name it in `removed`.
"""
JUDGE = """The real thing: {label}. {description}
Moving parts seen in the photo: {moving}.

The made one measures {x:.3f} by {y:.3f} by {z:.3f} m (front to back, across, up). \
Its parts: {parts}.
Its joints: {joints}.
{posed}{scope}
Judge it.
"""
LEANS = "In the crop it is turned over: {way}. The pictures of the made one show it upright.\n"
NO_ARTICULATION = "Leave `articulation` out of account: give it 10 and list no faults of it.\n"
NO_GEOMETRY = (
    "Leave `geometry` and `colour` out of account: give them 10, list no faults of them.\n"
)


class Subject(NamedTuple):
    """An object to be programmed."""

    node: TreeNode
    crop: Picture
    note: str = ""
    """Description of the parts that the crop does not show; empty if it shows all."""


def program_request(subject: Subject) -> Request[ProgramAnswer]:
    """Return the request for an object's first program."""
    return _program_request(f"program:{subject.node.name}", _ask(subject), subject.crop)


def repair_request(
    subject: Subject,
    program: str,
    signals: Sequence[Signal],
    before: Sequence[Signal] | None = None,
) -> Request[ProgramAnswer]:
    """Return the request for a program without the signals of the last one.

    Args:
        subject: the object.
        program: the last program.
        signals: signals of the last program.
        before: signals of the program before it; the request marks what is new, left and repaired.
    """
    known = {signal.identity for signal in before or ()}
    lines = []
    for signal in signals:
        again = "(still) " if signal.identity in known else "(new) " if known else ""
        lines.append(f"- {again}{signal.phrase()}")
    gone = known - {signal.identity for signal in signals}
    if gone:
        codes = sorted({str(identity[0]) for identity in gone})
        lines.append(f"- (mended since the program before: {', '.join(codes)})")
    heading = "It was run and checked. Mend this:"
    return _revision_request(f"debug:{subject.node.name}", subject, program, heading, lines)


def revise_request(
    subject: Subject, program: str, critique: ProgramCritique
) -> Request[ProgramAnswer]:
    """Return the request for a program without the critic's faults."""
    lines = [f"- {fault.part}: {fault.what} -> {fault.change}" for fault in critique.faults]
    heading = "It runs. Drawn and held beside the photo, it differs:"
    return _revision_request(f"revise:{subject.node.name}", subject, program, heading, lines)


def judge_request(
    node: TreeNode,
    pictures: Sequence[Picture],
    described: dict[str, str],
    size: tuple[float, float, float],
    options: ProgramOptions,
) -> Request[ProgramCritique]:
    """Return the request to the critic about pictures of an object beside its crop.

    Args:
        node: the object.
        pictures: the crop, "made", and if it has joints "opened".
        described: the programmed object's "parts" and "joints" in words.
        size: edges of the programmed object [m].
        options: which criteria are on.
    """
    scope = "" if options.articulation_critic else NO_ARTICULATION
    scope += "" if options.geometry_critic else NO_GEOMETRY
    x, y, z = size
    prompt = JUDGE.format(
        label=node.label,
        description=node.description,
        moving=_moving(node),
        scope=scope,
        posed=_posed(node, LEANS),
        x=x,
        y=y,
        z=z,
        **described,
    )
    name = f"judge:{node.name}"
    return Request(
        "critic", name, package_text(__package__, "critic"), prompt, ProgramCritique, pictures
    )


def _program_request(name: str, prompt: str, crop: Picture) -> Request[ProgramAnswer]:
    return Request(
        "programmer", name, package_text(__package__, "guide"), prompt, ProgramAnswer, [crop]
    )


def _revision_request(
    name: str, subject: Subject, program: str, heading: str, lines: list[str]
) -> Request[ProgramAnswer]:
    prompt = MEND.format(
        ask=_ask(subject), program=program.strip(), heading=heading, findings="\n".join(lines)
    )
    return _program_request(name, prompt, subject.crop)


def _ask(subject: Subject) -> str:
    node = subject.node
    x, y, z = node.box3d.size
    return ASK.format(
        name=node.name,
        label=node.label,
        description=node.description or "-",
        x=x,
        y=y,
        z=z,
        moving=_moving(node),
        opened=_opened(node),
        posed=_posed(node, TILTED),
        seen=HIDDEN.format(note=subject.note) if subject.note else WHOLE,
    )


def _moving(node: TreeNode) -> str:
    if not node.articulation:
        return "none noted"
    return ", ".join(f"{state.part} ({state.type})" for state in node.articulation)


def _opened(node: TreeNode) -> str:
    parts = [f"{part.part} {part.opening:.0%} open" for part in node.articulation if part.opening]
    return OPENED.format(parts=", ".join(parts)) if parts else ""


def _posed(node: TreeNode, words: str) -> str:
    """Describe the tilt of an object that lies or leans; return "" for an upright one."""
    x, y, z = rotate(node.base_tilt, (0.0, 0.0, 1.0)).tolist()
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, z))))
    if degrees < MIN_TILT_DEG:
        return ""
    if degrees > 180 - MIN_TILT_DEG:
        return words.format(way="it stands upside down")
    side = ("front" if x > 0 else "back") if abs(x) >= abs(y) else ("left" if y > 0 else "right")
    return words.format(way=f"tilted by {degrees:.0f} degrees, its top towards its own {side}")
