"""Requests to the programmer to write, repair or revise an object's program, and their schema."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from ..checks.signals import Signal
from ..config import Language
from ..mllm import Picture, Request, package_text
from .critique import Critique, corrected_box
from .subject import (
    Edges,
    Subject,
    moving_parts,
    opened_parts,
    tilt_in_words,
    view_in_words,
)

# Titles, docstrings and descriptions of response schemas are part of the requests. Recorded
# responses (tapes) match only requests that are exactly equal.


class ProgramResponse(BaseModel):
    """The programmer's response."""

    model_config = ConfigDict(extra="forbid", title="Program")

    program: str = Field(description="The whole program, plain Python text, without code fences.")
    notes: str = Field(default="", description="Briefly: what you guessed or could not see.")
    removed: list[str] = Field(
        default=[],
        description="Names of the earlier program's parts and joints that this one leaves out on "
        "purpose; empty if there are none.",
    )
    box: Edges | None = Field(
        default=None,
        description="null if the measured box can be right. Only if it contradicts the crop, or "
        "such objects never have that size: the object's size (x, y, z) in metres; the program "
        "fills that box instead.",
    )


_ASK = """Write the program of this object.

name: {name}
label: {label}
description: {description}
measured box{opened}: {x:.3f} m (x, front to back) by {y:.3f} m (y) by {z:.3f} m (z, up)
moving parts seen: {moving}
{view}{posed}{seen}
The picture "crop" is cut out of the photo around the object; grey frames in it mark neighbouring
objects, which do not belong to it.
"""
_TILTED = "In the photo {way}. Box and axes are those of the upright object: draw it upright.\n"
_HIDDEN = "In the crop it is {note}: complete it as such objects usually are."
_WHOLE = "All of it is visible, with nothing in front of it."
_REPAIR = """{ask}
This is the program so far:

```python
{program}
```

{heading}

{findings}

Write the whole program again, repaired. Keep every part and joint that was right. If you leave
one out on purpose, name it in `removed`.
"""
_STAGE = """{ask}
{accepted}
Write the {file} program.
"""
_ACCEPTED = """
This is the {file} program, which was run, checked and accepted:

```python
{text}
```
"""


class StageInput(NamedTuple):
    """Stage of a request, and the accepted programs of earlier stages."""

    file: str = "program"
    """Name of the stage: "program", or "geometry", "articulation" or "export"."""
    earlier_texts: Mapping[str, str] = {}
    """Text of the accepted program of each earlier stage, by stage name."""
    language: Language = "sdk"


def program_request(subject: Subject, stage: StageInput) -> Request[ProgramResponse]:
    """Return the request for an object's first program."""
    return _request("program", subject, stage, _ask(subject, stage))


def repair_request(
    subject: Subject,
    stage: StageInput,
    program: str,
    signals: Sequence[Signal],
    earlier: Sequence[Signal] | None = None,
) -> Request[ProgramResponse]:
    """Return the request to repair a program whose checks reported `signals`.

    `earlier` contains the signals of the previous program. If it is not empty, the request marks
    each signal as new or remaining, and lists the codes of signals that no longer occur.
    """
    known = {signal.identity for signal in earlier or ()}
    lines = []
    for signal in signals:
        mark = "(still) " if signal.identity in known else "(new) " if known else ""
        lines.append(f"- {mark}{signal.phrase()}")
    repaired = known - {signal.identity for signal in signals}
    if repaired:
        codes = sorted({str(identity[0]) for identity in repaired})
        lines.append(f"- (repaired since the last program: {', '.join(codes)})")
    heading = "It was run and checked. Repair this:"
    prompt = _repair_prompt(_ask(subject, stage), program, heading, lines)
    return _request("debug", subject, stage, prompt)


def revise_request(
    subject: Subject,
    stage: StageInput,
    program: str,
    critiques: Sequence[Critique],
    built: Picture | None = None,
) -> Request[ProgramResponse]:
    """Return the request to revise a program so that it corrects the faults that critics found.

    Args:
        subject: the object.
        stage: stage of the program.
        program: the program.
        critiques: critiques whose faults the request lists.
        built: picture of the built object, as shown to the critics; None omits it.
    """
    lines = [
        f"- {fault.part}: {fault.what} -> {fault.change}"
        for critique in critiques
        for fault in critique.faults
    ]
    if any(corrected_box(critique) for critique in critiques):
        lines.append(
            "- object: the measured box was wrong; it is corrected above -> fill the corrected box"
        )
    shown = "" if built is None else f' The picture "{built.label}" shows what it builds.'
    heading = f"It runs.{shown} Rendered and compared with the photo, it differs:"
    prompt = _repair_prompt(_ask(subject, stage), program, heading, lines)
    return _request("revise", subject, stage, prompt, () if built is None else (built,))


def reprogram_request(
    subject: Subject, stage: StageInput, program: str, findings: Sequence[str]
) -> Request[ProgramResponse]:
    """Return the request to rewrite a program whose object does not move like the real object."""
    heading = (
        "It runs and looks like the photo. Simulated by itself on a level floor, it does not "
        "behave as the real object would:"
    )
    lines = [f"- {finding}" for finding in findings]
    lines.append(
        "- object: keep what the photo shows; change shapes, parts and joints only as far as needed"
    )
    prompt = _repair_prompt(_ask(subject, stage), program, heading, lines)
    return _request("reprogram", subject, stage, prompt)


def instructions(file: str, language: Language = "sdk") -> str:
    """Return the system prompt of a stage: the guide to the language, and the stage's task."""
    prefix = "blender_" if language == "blender" else ""
    guide = package_text(__package__, f"{prefix}guide")
    return guide if file == "program" else f"{guide}\n{package_text(__package__, prefix + file)}"


def _request(
    kind: str,
    subject: Subject,
    stage: StageInput,
    prompt: str,
    more_pictures: Sequence[Picture] = (),
) -> Request[ProgramResponse]:
    """Return a request that is named after its kind, its stage and its object.

    Kinds are "program", "debug", "revise" and "reprogram".
    """
    name = kind if stage.file == "program" else f"{kind}-{stage.file}"
    name = stage.file if kind == "program" else name
    system = instructions(stage.file, stage.language)
    pictures: list[Picture] = [subject.crop, *more_pictures]
    name = f"{name}:{subject.node.name}"
    return Request("programmer", name, system, prompt, ProgramResponse, pictures)


def _repair_prompt(ask: str, program: str, heading: str, lines: list[str]) -> str:
    return _REPAIR.format(
        ask=ask, program=program.strip(), heading=heading, findings="\n".join(lines)
    )


def _ask(subject: Subject, stage: StageInput) -> str:
    node = subject.node
    x, y, z = node.box3d.size
    ask = _ASK.format(
        name=node.name,
        label=node.label,
        description=node.description or "-",
        x=x,
        y=y,
        z=z,
        moving=moving_parts(node),
        opened=opened_parts(node),
        view=view_in_words(node, subject.camera),
        posed=tilt_in_words(node, _TILTED),
        seen=_HIDDEN.format(note=subject.note) if subject.note else _WHOLE,
    )
    if stage.file == "program":
        return ask
    accepted = "".join(
        _ACCEPTED.format(file=name, text=text.strip()) for name, text in stage.earlier_texts.items()
    )
    return _STAGE.format(ask=ask, accepted=accepted, file=stage.file)
