"""Reconstruct a photograph (paper Figure 2), or repeat the refinement of a run.

Each step reads files of the run folder, calls a package and writes files. A step declares
everything that it reads as its inputs. The run folder repeats a step if its inputs have changed.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from ..config import Config
from ..errors import ConfigError, RunError
from ..io import bounded_by
from ..mllm import Panel, open_panel
from ..names import Step
from ..parse.photo import Photo
from ..run_folder import STEPS, Mode, Result, RunFolder, read_run, run_options, step_times
from ..spec import read_scene
from .given_evidence import Given, keep_evidence, kept_inputs, known_photo
from .object_steps import parse_photo, program_objects, verify_objects
from .scene_steps import compose_scene, export_files, refine_layout, write_metrics
from .step_context import COMPOSED, TAPE, TREE, StepContext, read_tree

STEP_FUNCTIONS: dict[str, Callable[[StepContext], None]] = {
    "parse": parse_photo,
    "program": program_objects,
    "verify": verify_objects,
    "compose": compose_scene,
    "refine": refine_layout,
    "export": export_files,
}
"""Function of each step in `run_folder.STEPS`."""


def reconstruct(
    photo: Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    until: str | None = None,
    resume: bool = False,
    start: str | None = None,
    overwrite: bool = False,
    record: Path | None = None,
    mailbox: Path | None = None,
    tapes: tuple[Path, ...] = (),
    evidence: Given | None = None,
) -> Result:
    """Turn one photograph into a simulation-ready scene (paper Figure 2).

    Each step reads the files of earlier steps and writes its own, so a resumed run produces the
    same bytes as an uninterrupted one.

    Args:
        photo: the picture file.
        out: the run folder: new, empty, or with a run to continue.
        config: all options.
        until: stop after this step: parse, program, verify, compose, refine or export.
        resume: if True, keep finished steps whose inputs have not changed.
        start: repeat this step and all later ones.
        overwrite: if True, replace the run in `out`.
        record: file for the recorded responses (tape) of the models; by default `answers.tape.json`
            in the run folder.
        mailbox: folder in which the provider `mailbox` exchanges requests and responses; by default
            `mailbox` in the run folder.
        tapes: additional tapes, or folders of tapes, for the provider `replay`.
        evidence: what is known of the camera, the depths and the masks of the photograph, or the
            path of an evidence file. A run that continues keeps its own unless another is given.

    Raises:
        NeoWorldError: the run fails. The subclass tells the cause: the photograph, the
            configuration, the folder, the models, or a program that does not build an object.
    """
    photo, out = _path(photo, "photo"), _path(out, "out")
    config = _checked_config(config)
    mode = _mode(until, resume=resume, start=start, overwrite=overwrite)
    if evidence is not None and start not in (None, "parse"):
        raise RunError(
            f"--from {start} keeps the parse and its evidence: give new evidence with --resume, "
            "which repeats the steps that it changes"
        )
    with bounded_by(config.files):
        continues = mode in ("resume", "redo")
        picture, known = known_photo(photo, config, evidence, out if continues else None)
        open_models = partial(
            _open_models, config, out, picture.sha256, tapes=tapes, mailbox=mailbox
        )
        if config.program.language == "blender" and until != "parse":
            from ..program.blender.blender_process import require_blender

            require_blender()
        open_models()  # Report a wrong provider or key before anything is written to the folder.
        other_photo = _other_photo(out, picture)
        if other_photo and continues:
            raise RunError(
                f"{out} is a run of another photograph ({other_photo}), not of {photo}: use that "
                "one, replace the run with --overwrite, or name another folder"
            )
        with RunFolder(out, config, mode, step=start) as run:
            run.record("photo", name=photo.name, sha256=picture.sha256)
            if other_photo:
                (run.path / TAPE).unlink(missing_ok=True)
            models = open_models(record=record or out / TAPE)
            keep_evidence(run, known)
            run_steps(run, config, models, picture, until=until)
            return finish(run, until)


def run_steps(
    run: RunFolder,
    config: Config,
    models: Panel | None,
    photo: Photo | None = None,
    *,
    first: Step = "parse",
    until: str | None = None,
) -> None:
    """Run the steps from `first` to `until`, by default to the last one.

    Args:
        run: the open run folder.
        config: all options.
        models: required by `parse` and `program`, and by later steps if the options say so.
        photo: the photograph; required by `parse` and `program`.
        first: first step.
        until: last step; if None, run all later steps.
    """
    with recorded_costs(run, models):
        context = StepContext(run, config, photo, models, kept_inputs(run))
        for step in STEPS[STEPS.index(first) :]:
            with run.timed(step):
                STEP_FUNCTIONS[step](context)
            if step == until:
                break


@contextmanager
def recorded_costs(run: RunFolder, models: Panel | None) -> Iterator[None]:
    """Continue the run's cost ledger, so that the cap covers the whole run, and record it.

    Raises:
        RunError: the run's ledger is damaged.
    """
    if models is None:
        yield
        return
    if run.data["mllm"]:
        try:
            models.ledger.add_earlier(run.data["mllm"])
        except (AttributeError, LookupError, TypeError, ValueError):
            raise RunError(
                f"{run.path / 'run.json'}: the costs under mllm are damaged: repair them, or start "
                "over with --overwrite"
            ) from None
    run.waited = lambda: models.waited_s
    with models:
        try:
            yield
        finally:
            run.record("mllm", provider=models.name, **models.ledger.to_json())


def refine_again(
    folder: Path | str, config: Config | None = None, over: dict[str, Any] | None = None
) -> Result:
    """Repeat the refinement and the export of a run's composed scene, and keep earlier steps.

    Args:
        folder: the run folder; its compose step must have finished.
        config: all options; by default those of the run.
        over: a nested mapping of options that override the options of the run, if `config` is None.

    Raises:
        RunError: the folder is not a run, or its scene has not been composed yet.
    """
    folder = _path(folder, "folder")
    earlier = read_run(folder)
    if not (folder / COMPOSED).is_file():
        raise RunError(f"{folder} has no composed scene yet; continue with reconstruct --resume")
    if config is None:
        config = earlier_options(folder, over or {})
    config = _checked_config(config)
    with bounded_by(config.files):
        models = None
        if config.refine.semantic.scorer == "mllm":
            sha256 = earlier["photo"].get("sha256")
            models = _open_models(config, folder, sha256, record=folder / TAPE)
        with RunFolder(folder, config, "redo", step="refine") as run:
            run_steps(run, config, models, first="refine")
            return finish(run, None)


def _open_models(
    config: Config,
    folder: Path,
    photo: str | None,
    *,
    record: Path | None = None,
    tapes: tuple[Path, ...] = (),
    mailbox: Path | None = None,
) -> Panel:
    return open_panel(
        config.mllm,
        config.provider,
        photo=photo,
        tapes=tapes,
        mailbox=mailbox or folder / "mailbox",
        record=record,
        made=f"recorded from provider {config.provider}",
    )


def earlier_options(folder: Path, over: dict[str, Any]) -> Config:
    """Return the options with which the refinement of a run is repeated; see `run_options`.

    Raises:
        ConfigError: as in `run_options`, or the options name code to run, or a server to send a key
            to.
    """
    config = run_options(folder, over)
    refuse_code(config, str(folder / "run.json"))
    calls_models = config.refine.semantic.scorer == "mllm"
    if calls_models and (config.mllm.base_url is not None or config.mllm.prices is not None):
        raise ConfigError(
            f"{folder / 'run.json'} names a server for models ({config.mllm.base_url}), which "
            "would receive your key: if you trust it, give mllm.base_url by --config or --set"
        )
    return config


def refuse_code(config: Config, source: str) -> None:
    """Refuse options from an untrusted source that name code to run.

    Raises:
        ConfigError: a reward term or the optimizer is named by its import path.
    """
    from ..search.optimizer import OPTIMIZERS
    from ..search.problem import TERMS

    code_names = [name for name in config.refine.reward.terms if name not in TERMS]
    code_names += [config.refine.optimizer] * (config.refine.optimizer not in OPTIMIZERS)
    if code_names:
        raise ConfigError(
            f"{source} names code to run ({', '.join(code_names)}): if you "
            "trust it, give the option by --config or --set"
        )


def _object_names(run: RunFolder) -> list[str]:
    if (run.path / TREE).is_file():
        return [node.name for node in read_tree(run).nodes]
    return [item.name for item in read_scene(run.path / COMPOSED).objects]


def _path(value: object, name: str) -> Path:
    if isinstance(value, str | Path):
        return Path(value)
    raise ConfigError(f"{name} must be a path, got {type(value).__name__}")


def _checked_config(config: object) -> Config:
    if config is None:
        return Config()
    if isinstance(config, Config):
        return config
    raise ConfigError(
        f"config must be a Config, got {type(config).__name__}: "
        "create one with neoworld_mjx.config.load_config(overrides={...})"
    )


def _mode(until: str | None, *, resume: bool, start: str | None, overwrite: bool) -> Mode:
    """Return the mode of the run folder for the options of `reconstruct`."""
    if overwrite and (resume or start is not None):
        other = "--resume" if resume else "--from"
        raise RunError(f"--overwrite starts over and {other} continues a run: give one of them")
    if start in STEPS and until in STEPS and STEPS.index(until) < STEPS.index(start):
        raise RunError(f"--until {until} precedes --from {start}: no step would run")
    if start is not None:
        return "redo"
    if resume:
        return "resume"
    return "overwrite" if overwrite else "new"


def _other_photo(out: Path, photo: Photo) -> str:
    """Return the name of the run's photograph if `out` is a run of another one, otherwise ""."""
    try:
        if not (out / "run.json").is_file():
            return ""
    except OSError:
        return ""  # RunFolder reports it.
    earlier = read_run(out)["photo"]
    if earlier.get("sha256", photo.sha256) == photo.sha256:
        return ""
    return earlier.get("name") or "of unknown name"


def finish(run: RunFolder, until: str | None) -> Result:
    """Mark the run as finished, or as stopped after `until`; write its metrics and its report."""
    from ..view.report.run_report import write_report

    run.finish(until)
    write_metrics(run)
    times = step_times(run.data)
    write_report(run.path)
    return Result(
        folder=run.path,
        until=until,
        metrics=run.data["metrics"],
        seconds={step: seconds for step, (seconds, _) in times.items()},
        waiting={step: waiting for step, (_, waiting) in times.items()},
        fallbacks=run.data["fallbacks"],
        notes=run.data["notes"],
        objects=_object_names(run),
        cost=run.data["mllm"],
    )
