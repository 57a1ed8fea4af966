"""Attempts at an object's program, with checks and critiques, and the result of Step 2."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from ..checks.allowance import Allowance
from ..checks.signals import Signal
from ..errors import ProgramError
from ..spec import ObjectSpec
from .critique import Critique, mean_score
from .sandbox import BuildResult

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
