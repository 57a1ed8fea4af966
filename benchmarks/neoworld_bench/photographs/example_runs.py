"""The bundled examples from photograph to scene, with the responses of their tapes."""

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from neoworld_mjx.config import Config
from neoworld_mjx.errors import PhotoError, choices
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.bundled_examples import BundledExample, bundled_examples
from neoworld_mjx.pipeline.step_context import TAPE
from neoworld_mjx.spec import read_scene

from ..rows import Row


class ExampleRow(Row):
    """One example, from photograph to exported scene."""

    example: str
    answered_by: str
    """Who or what gave the responses."""
    date: str
    """Date of the responses."""
    prompts: str
    """Version of the prompts that they answer."""
    objects: int
    """Objects other than supports of the environment."""
    joints: int
    """Joints that move."""
    calls: int
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
    names: Sequence[str], config: Config
) -> Mapping[str, Callable[[], list[ExampleRow]]]:
    """Return a function that reconstructs each example from its tape, by name; all for no names.

    Raises:
        PhotoError: there is no such example.
    """
    examples = bundled_examples()
    for name in names:
        if name not in examples:
            raise PhotoError(f"example: {choices(name, examples)}")
    return {
        name: partial(_temporary_run, name, examples[name], config) for name in names or examples
    }


def _temporary_run(name: str, example: BundledExample, config: Config) -> list[ExampleRow]:
    with tempfile.TemporaryDirectory() as folder:
        return [run_example(name, example, config, Path(folder) / name)]


def run_example(name: str, example: BundledExample, config: Config, run: Path) -> ExampleRow:
    """Reconstruct one example from its tape into a run folder, and return its row."""
    config = config.model_copy(update={"provider": "replay"})
    began = _processor_s()
    (run / TAPE).unlink(missing_ok=True)  # What it answers would not count as calls.
    result = reconstruct(example.photo, run, config, overwrite=True)
    items = [item for item in read_scene(run).objects if not item.environment]
    m = result.metrics
    return ExampleRow(
        example=name,
        answered_by=example.responses.by,
        date=str(example.responses.date),
        prompts=example.responses.prompts,
        objects=len(items),
        joints=sum(joint.type != "fixed" for item in items for joint in item.spec.joints),
        calls=result.cost["calls"],
        valid=bool(result.passed),
        drift_mm=1e3 * m["max_drift_m"],
        tilt_deg=m["max_tilt_deg"],
        overlap_mm=1e3 * m["max_depth_m"],
        box_iou=m["box_iou"]["refined"],
        fallbacks=len(result.fallbacks),
        seconds=sum(result.seconds.values()) - sum(result.waiting.values()),
        processor_s=_processor_s() - began,
    )


def _processor_s() -> float:
    return sum(os.times()[:4])
