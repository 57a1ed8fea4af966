"""Requests to the programmer, the attempts that answer them, and the result of Step 2.

The programmer is asked to write, repair or revise an object's program. An attempt is a program with
the results of its checks and critiques.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from ..checks.signals import Allowance, Signal
from ..config import Language
from ..errors import ProgramError
from ..mllm import Picture, Request, package_text
from ..spec import ObjectSpec
from .building import BuildResult
from .critique import (
    Critique,
    Edges,
    Subject,
    corrected_box,
    mean_score,
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
        description="null if the given box can be right. Only if it contradicts the crop, or "
        "such objects never have that size: the object's size (x, y, z) in metres; the program "
        "fills that box instead.",
    )


_ASK = """Write the program of this object.

name: {name}
label: {label}
description: {description}
box{opened}, measured in the photo: {x:.3f} m (x, front to back) by {y:.3f} m (y) by \
{z:.3f} m (z, up)
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
            "- object: the given box was wrong; it is corrected above -> fill the corrected box"
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


Size = tuple[float, float, float]
DEFAULT_SCORE = 5.0
"""Score of a program that no critic has scored."""


def join_texts(texts: Mapping[str, str]) -> str:
    """Join the texts of the stages, in order, into one program.

    Each text may use names that earlier texts define. A single text is returned unchanged.
    """
    if len(texts) == 1:
        return next(iter(texts.values()))
    return "\n".join(f"# {name}.py\n{text}" for name, text in texts.items())


@dataclass(frozen=True)
class ProgramAttempt:
    """A program's text, with the results of its checks and its critiques."""

    stage: str
    """Kind of request that returned the program: "program", "debug", "revise" or "reprogram".

    It is "support" if the program was written without a model.
    """
    text: str
    built: BuildResult
    notes: str = ""
    critiques: Mapping[str, Critique] = field(default_factory=dict)
    """Critiques by critic: "geometry", "articulation", "export"."""
    size: Size | None = None
    """Edges [m] of the box that the object should fill; if None, it should fill the parsed box."""
    earlier_texts: Mapping[str, str] = field(default_factory=dict)
    """Accepted texts of the earlier stages, by stage."""
    file: str = "program"
    """Name of the stage: "program", or "geometry", "articulation" or "export"."""

    @property
    def texts(self) -> dict[str, str]:
        """Texts of all stages up to and including this stage, by stage."""
        return {**self.earlier_texts, self.file: self.text}

    @property
    def score(self) -> float:
        """Score of the program, at least 0; it is 0 if the program builds no object.

        This is the mean score of the critics (`DEFAULT_SCORE` without critiques), minus one point
        for each error, minus the relative error of the edge that deviates most.
        """
        if self.built.spec is None:
            return 0.0
        score = mean_score(self.critiques) if self.critiques else DEFAULT_SCORE
        errors = [signal for signal in self.built.signals if signal.severity == "error"]
        deviation = sum(
            min(1.0, abs(signal.value or 0.0))
            for signal in self.built.signals
            if signal.code == "proportions"
        )
        return max(0.0, score - len(errors) - deviation)

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """Sort key for comparing attempts of a stage; the largest key is the best attempt."""
        lost = any(signal.code == "lost" for signal in self.built.signals)
        return self.built.spec is not None, not lost, self.built.ok, self.score

    def to_json(self) -> dict[str, object]:
        """Return the attempt as a JSON object."""
        verdicts = {
            name: critique.model_dump(mode="json") for name, critique in self.critiques.items()
        }
        return {
            "file": self.file,
            "stage": self.stage,
            "program": self.text,
            "notes": self.notes,
            "signals": _dumped(self.built.signals),
            "verdicts": verdicts,
            "score": round(self.score, 4),
        }


@dataclass(frozen=True)
class SynthesisResult:
    """Result of the synthesis of an object's program."""

    spec: ObjectSpec | None
    texts: Mapping[str, str]
    """Texts by stage: either "program", or "geometry", "articulation" and "export"."""
    signals: tuple[Signal, ...]
    score: float
    rounds: tuple[ProgramAttempt, ...]
    fallbacks: tuple[tuple[str, str], ...] = ()
    """Pairs of what failed (a stage, a request, or remaining errors) and the reason."""
    allowances: tuple[Allowance, ...] = ()
    """Overlaps that the program declares."""
    size: Size | None = None
    """Corrected edges [m] of the parsed box; None if they were not corrected."""

    @property
    def text(self) -> str:
        """The whole program."""
        return join_texts(self.texts)

    @property
    def reason(self) -> str:
        """Why the program builds no object, in one line; empty if it builds one."""
        if self.spec is not None:
            return ""
        signals = self.rounds[-1].built.signals if self.rounds else ()
        first = next((s.phrase() for s in signals if s.severity == "error"), "no program")
        return (
            f"none of {len(self.rounds)} programs could be built; the last failed with: {first}; "
            "to request more, use --resume with a higher program.debug_rounds"
        )

    def files(self) -> dict[str, str]:
        """Return the contents of program.py, spec.json and program.json by file name.

        With several stages, the text of each stage is added, such as geometry.py.

        Raises:
            ProgramError: the program builds no object.
        """
        if self.spec is None:
            raise ProgramError(self.reason)
        stages = self.texts if len(self.texts) > 1 else {}
        return {
            "program.py": self.text,
            "spec.json": self.spec.to_json(),
            "program.json": self.to_json(),
            **{f"{file}.py": text for file, text in stages.items()},
        }

    def to_json(self) -> str:
        """Return all rounds as JSON."""
        rounds = [
            {**attempt.to_json(), "kept": self.texts.get(attempt.file) == attempt.text}
            for attempt in self.rounds
        ]
        data = {
            "score": round(self.score, 4),
            "signals": _dumped(self.signals),
            "fallbacks": [list(entry) for entry in self.fallbacks],
            "allowances": [allowance._asdict() for allowance in self.allowances],
            "size": self.size,
            "rounds": rounds,
        }
        return json.dumps(data, indent=1) + "\n"


def written_without_model(stage: str, text: str, built: BuildResult) -> SynthesisResult:
    """Return the result of a program that was written without a model, such as a support's.

    Args:
        stage: origin of the program: "support" or "annotation".
        text: the program.
        built: the result of running the program.
    """
    attempt = ProgramAttempt(stage, text, built)
    errors = [signal for signal in built.signals if signal.severity == "error"]
    fallbacks = ()
    if built.spec is not None and errors:
        reasons = "; ".join(signal.phrase() for signal in errors[:4])
        fallbacks = ((f"{built.spec.name}: kept with {len(errors)} errors", reasons),)
    return SynthesisResult(
        *(built.spec, attempt.texts, built.signals, attempt.score, (attempt,), fallbacks),
        allowances=built.allowances,
    )


def _dumped(signals: tuple[Signal, ...]) -> list[dict[str, object]]:
    return [signal.model_dump(mode="json", exclude_none=True) for signal in signals]
