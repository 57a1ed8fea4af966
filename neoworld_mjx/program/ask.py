"""Requests to the programmer: write an object's program, repair it, revise it; their schema."""

from collections.abc import Mapping, Sequence

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

# Titles, docstrings and descriptions of the answers are part of the requests: tapes hold answers to
# these very ones.


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
_MEND = """{ask}
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


def program_request(
    subject: Subject,
    file: str = "program",
    before: Mapping[str, str] | None = None,
    language: Language = "sdk",
) -> Request[ProgramResponse]:
    """Return the request for an object's first program.

    Args:
        subject: the object.
        file: name of the stage: program, or geometry, articulation, export.
        before: accepted texts of the stages before it.
        language: that the program is to be written in.
    """
    name, ask = _named(file, "program", subject), _ask(subject, file, before)
    return _request(name, subject, file, ask, language)


def repair_request(
    subject: Subject,
    program: str,
    signals: Sequence[Signal],
    earlier: Sequence[Signal] | None = None,
    file: str = "program",
    before: Mapping[str, str] | None = None,
    language: Language = "sdk",
) -> Request[ProgramResponse]:
    """Return the request for a program without the signals of the last one.

    Args:
        subject: the object.
        program: the last program.
        signals: signals of the last program.
        earlier: signals of the program before it; the request marks what is new, left and
            repaired.
        file: name of the stage.
        before: accepted texts of the stages before it.
        language: that the program is to be written in.
    """
    known = {signal.identity for signal in earlier or ()}
    lines = []
    for signal in signals:
        again = "(still) " if signal.identity in known else "(new) " if known else ""
        lines.append(f"- {again}{signal.phrase()}")
    repaired = known - {signal.identity for signal in signals}
    if repaired:
        codes = sorted({str(identity[0]) for identity in repaired})
        lines.append(f"- (repaired since the last program: {', '.join(codes)})")
    heading = "It was run and checked. Repair this:"
    ask = _ask(subject, file, before)
    name, prompt = _named(file, "debug", subject), _mend(ask, program, heading, lines)
    return _request(name, subject, file, prompt, language)


def revise_request(
    subject: Subject,
    program: str,
    critiques: Sequence[Critique],
    file: str = "program",
    before: Mapping[str, str] | None = None,
    language: Language = "sdk",
) -> Request[ProgramResponse]:
    """Return the request for a program without the critics' faults; see `repair_request`."""
    lines = [
        f"- {fault.part}: {fault.what} -> {fault.change}"
        for critique in critiques
        for fault in critique.faults
    ]
    if any(corrected_box(critique) for critique in critiques):
        lines.append(
            "- object: the measured box was wrong; it is corrected above -> fill the corrected box"
        )
    heading = "It runs. Rendered and compared with the photo, it differs:"
    ask = _ask(subject, file, before)
    name, prompt = _named(file, "revise", subject), _mend(ask, program, heading, lines)
    return _request(name, subject, file, prompt, language)


def instructions(file: str, language: Language = "sdk") -> str:
    """Return the system text of a stage: the guide to the language, and what it is to write."""
    prefix = "blender_" if language == "blender" else ""
    guide = package_text(__package__, f"{prefix}guide")
    return guide if file == "program" else f"{guide}\n{package_text(__package__, prefix + file)}"


def _request(
    name: str, subject: Subject, file: str, prompt: str, language: Language
) -> Request[ProgramResponse]:
    pictures: list[Picture] = [subject.crop]
    system = instructions(file, language)
    return Request("programmer", name, system, prompt, ProgramResponse, pictures)


def _named(file: str, stage: str, subject: Subject) -> str:
    if file == "program":
        return f"{stage}:{subject.node.name}"
    return f"{file if stage == 'program' else f'{stage}-{file}'}:{subject.node.name}"


def _mend(ask: str, program: str, heading: str, lines: list[str]) -> str:
    return _MEND.format(
        ask=ask, program=program.strip(), heading=heading, findings="\n".join(lines)
    )


def _ask(subject: Subject, file: str, before: Mapping[str, str] | None) -> str:
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
    if file == "program":
        return ask
    accepted = "".join(
        _ACCEPTED.format(file=name, text=text.strip()) for name, text in (before or {}).items()
    )
    return _STAGE.format(ask=ask, accepted=accepted, file=file)
