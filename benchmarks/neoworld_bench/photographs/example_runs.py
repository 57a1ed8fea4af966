"""The bundled examples from photograph to scene: the bundled responses, or another provider's."""

import datetime
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError, PhotoError, choices
from neoworld_mjx.mllm.replay import SUFFIX, Tape
from neoworld_mjx.pipeline import Result, reconstruct
from neoworld_mjx.pipeline.bundled_examples import BundledExample, bundled_examples
from neoworld_mjx.pipeline.step_context import TAPE
from neoworld_mjx.spec import SceneObject, read_scene

from ..rows import Row

COMPARED = (
    *("objects", "joints", "calls", "valid", "drift_mm", "tilt_deg", "overlap_mm", "box_iou"),
    "fallbacks",
)
"""Columns of which differences are reported."""


class ExampleRow(Row):
    """One example, from photograph to exported scene."""

    example: str
    provider: str
    answered_by: str
    """Who or what gave the responses: models, and the tape's own words if they are bundled."""
    date: str
    """Date of the responses."""
    prompts: str
    """Version of the prompts that they answer."""
    objects: int
    """Objects other than supports of the environment."""
    joints: int
    """Joints that move."""
    calls: int
    tokens_in: int
    """Tokens as reported by the server; 0 for a tape."""
    tokens_out: int
    usd: float | None
    """Cost [USD]; None for a tape, and where a model has no price."""
    valid: bool
    drift_mm: float
    """Largest drift of an object in the 2 s of the final check."""
    tilt_deg: float
    overlap_mm: float
    """Deepest overlap of two objects, before or after."""
    box_iou: float
    """Mean IoU of visible boxes with those of the photograph."""
    fallbacks: int
    """Steps that did less than requested."""
    seconds: float
    """Time of the five steps, waiting for models excluded."""
    processor_s: float
    """Processor time of this process and those that it started."""


def example_jobs(
    names: Sequence[str], config: Config, provider: str, out: Path | None
) -> dict[str, Any]:
    """Return a function for each run, by name: the bundled tapes first, then another provider's.

    Args:
        names: examples; all if empty.
        config: all options, the provider excepted.
        provider: source of the responses; `replay` runs the bundled tapes alone.
        out: folder of the runs and of the tapes NAME.tape.json that another provider's responses
            are recorded on; None, for `replay` alone, for a temporary folder that is deleted.

    Raises:
        ConfigError: another provider lacks the folder.
        PhotoError: there is no such example.
    """
    if provider != "replay" and out is None:
        raise ConfigError(f"examples: provider {provider} needs --out DIR for its tapes and runs")
    examples = bundled_examples()
    for name in names:
        if name not in examples:
            raise PhotoError(f"example: {choices(name, examples)}")
    sources = ("replay",) if provider == "replay" else ("replay", provider)

    def job(name: str, source: str) -> Any:
        return lambda: [run_example(name, examples[name], config, source, out)]

    return {
        f"{source} {name}": job(name, source) for source in sources for name in names or examples
    }


def run_example(
    name: str, example: BundledExample, config: Config, provider: str, out: Path | None
) -> ExampleRow:
    """Reconstruct one example, and return its row."""
    config = config.model_copy(update={"provider": provider})
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        tape = None if provider == "replay" else folder / f"{name}{SUFFIX}"
        run = folder / provider / name
        began = _processor_s()
        if tape is None:
            (run / TAPE).unlink(missing_ok=True)  # What it answers would not count as calls.
            result = reconstruct(example.photo, run, config, overwrite=True)
            used = Tape.load(run / TAPE)
        else:
            # An interrupted run continues, and a repeated one answers from the tape.
            result = reconstruct(example.photo, run, config, resume=run.exists(), record=tape)
            used = Tape.load(tape)
            used.date = used.date or datetime.date.today().isoformat()
            used.save(tape)
        items = [item for item in read_scene(run).objects if not item.environment]
        spent = _processor_s() - began
    return _row(name, example, provider, result, used, items, spent)


def _row(
    name: str,
    example: BundledExample,
    provider: str,
    result: Result,
    used: Tape,
    items: Sequence[SceneObject],
    processor_s: float,
) -> ExampleRow:
    m, books = result.metrics, result.cost
    bundled = provider == "replay"
    models = ", ".join(sorted({entry.model for entry in used.answers.values()}))
    return ExampleRow(
        example=name,
        provider=provider,
        answered_by=example.responses.by if bundled else models,
        date=str(example.responses.date) if bundled else used.date,
        prompts=example.responses.prompts if bundled else used.prompts,
        objects=len(items),
        joints=sum(joint.type != "fixed" for item in items for joint in item.spec.joints),
        calls=books["calls"],
        tokens_in=books["tokens"]["input"],
        tokens_out=books["tokens"]["output"],
        usd=None if bundled else books["cost_usd"],
        valid=bool(result.passed),
        drift_mm=1e3 * m["max_drift_m"],
        tilt_deg=m["max_tilt_deg"],
        overlap_mm=1e3 * m["max_depth_m"],
        box_iou=m["box_iou"]["refined"],
        fallbacks=len(result.fallbacks),
        seconds=sum(result.seconds.values()) - sum(result.waiting.values()),
        processor_s=processor_s,
    )


def differences(rows: Sequence[ExampleRow]) -> Mapping[str, Mapping[str, tuple[Any, Any]]]:
    """Return by example the columns in which another provider's row differs from the tape's.

    Each is a pair: with the bundled responses, with the other provider's.
    """
    bundled = {row.example: row for row in rows if row.provider == "replay"}
    return {
        row.example: {
            name: (before, after)
            for name in COMPARED
            if (before := getattr(bundled[row.example], name)) != (after := getattr(row, name))
        }
        for row in rows
        if row.provider != "replay" and row.example in bundled
    }


def difference_lines(rows: Sequence[ExampleRow]) -> Iterator[str]:
    """Yield a line for each example that another provider answered, too."""
    for name, changed in differences(rows).items():
        parts = [f"{key} {_short(a)} -> {_short(b)}" for key, (a, b) in changed.items()]
        yield f"{name}: {', '.join(parts) or 'no difference'}"


def _processor_s() -> float:
    return sum(os.times()[:4])


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
