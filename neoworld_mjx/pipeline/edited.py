"""Continue a run after a person edited a program or the layout."""

from pathlib import Path

from ..compose.layout_patch import LayoutPatch, write_layout_patch
from ..config import Config
from ..errors import RunError
from ..io import bounded_by, read_object
from ..io.files import write_atomic
from ..program import BuildResult, build
from ..program.attempt import ProgramAttempt, SynthesisResult
from ..run_folder import Result, RunFolder, read_run
from .reconstruction import earlier_options, finish, models_of_run, run_steps


def search_again(folder: Path, patch: LayoutPatch) -> Result:
    """Apply a person's placements to the composed scene, and repeat the search from there.

    Every later composition applies the patch, which stays in the run folder. Steps with unchanged
    inputs are kept, so an unchanged patch repeats no step.

    Args:
        folder: the run folder; its verify step must have finished.
        patch: all placements by a person.

    Raises:
        NeoWorldError: the folder is not a run with a finished verify step, or a step fails.
    """
    config = _options(folder)
    with bounded_by(config.files):
        models = models_of_run(folder, config, read_run(folder), critic=False)
        with RunFolder(folder, config, "edited", step="verify") as run:
            write_layout_patch(folder, patch)
            run_steps(run, config, models, first="compose")
            return finish(run, None)


def rebuild(folder: Path, name: str, text: str) -> tuple[BuildResult, Result | None]:
    """Build a new program of an object and, if it is valid, repeat the later steps.

    Args:
        folder: the run folder; the object's program step must have finished.
        name: name of the object.
        text: the program.

    Returns:
        The build, and the result of the run. If the program fails or its object fails a check, the
        result is None, and no file changes.

    Raises:
        NeoWorldError: the folder is not a run with a finished program step for the object, or a
            later step fails.
    """
    config = _options(folder, verifies=True)
    step, object_folder = f"program/{name}", folder / "objects" / name
    with bounded_by(config.files):
        earlier = read_run(folder)
        if step not in earlier["steps"]:
            raise RunError(f"{folder} has no programmed object {name}: run the step program first")
        # A run folder is untrusted: its options must not disable the sandbox.
        built = build(text, config.program.model_copy(update={"sandbox": "monty"}))
        if built.spec is None or not built.ok:
            return built, None
        models = models_of_run(folder, config, earlier, critic=True)
        attempt = ProgramAttempt("edited", text, built)
        with RunFolder(folder, config, "edited", step="program") as run:
            path = object_folder / "program.json"
            size = read_object(path, RunError).get("size") if path.is_file() else None
            programmed = SynthesisResult(
                *(built.spec, {"program": text}, built.signals, attempt.score, (attempt,), ()),
                allowances=built.allowances,
                size=None if size is None else (size[0], size[1], size[2]),
            )
            for file, content in (
                ("program.py", text),
                ("spec.json", built.spec.to_json()),
                ("program.json", programmed.to_json()),
            ):
                write_atomic(object_folder / file, content)
            run.accept_edits(step)
            run_steps(run, config, models, first="verify")
            return built, finish(run, None)


def _options(folder: Path, *, verifies: bool = False) -> Config:
    return earlier_options(folder, read_run(folder)["config"], {}, verifies=verifies)
