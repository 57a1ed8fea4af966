"""Reconstruct a photograph (paper Figure 2), or refine the composed scene of a run again."""

from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from ..config import Config, load_config, merged
from ..errors import ConfigError, RunError
from ..mllm import open_panel
from ..parse.photo import Photo, load_photo
from ..run_folder import STEPS, RunFolder, read_run
from .steps import ANSWERS, COMPOSED, STEP_FUNCTIONS, StepContext, read_tree, write_metrics


@dataclass(frozen=True)
class Result:
    """The outcome of a run."""

    folder: Path
    until: str | None
    """The step after which the run was to stop; None for a whole run."""
    metrics: dict[str, Any]
    seconds: dict[str, float]
    """Seconds by step."""
    fallbacks: list[dict[str, str]]
    objects: list[str]
    passed: bool | None
    """Whether the refined scene is stable and free of penetration; None before refinement."""
    cost: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return the JSON object that `neoworld reconstruct --json` prints."""
        exported = self.passed is not None and self.until is None
        return {
            "scene": str(self.folder / "scene.xml") if exported else None,
            "folder": str(self.folder),
            "report": str(self.folder / "report.html"),
            "objects": self.objects,
            **{key: value for key, value in self.metrics.items() if key != "objects"},
            "passed": self.passed,
            "seconds": self.seconds,
            "fallbacks": self.fallbacks,
            "mllm": self.cost,
        }

    def __repr__(self) -> str:
        """Return three lines: the folder, the objects, and how the scene came out."""
        outcome = {None: "not refined", True: "passed", False: "failed its checks"}[self.passed]
        numbers = [
            f"{name} {self.metrics[name]:.2g}"
            for name in ("max_depth_m", "max_drift_m", "max_tilt_deg")
            if self.metrics.get(name) is not None
        ]
        return (
            f"Result({str(self.folder)!r}: {outcome} in {sum(self.seconds.values()):.1f} s\n"
            f"  objects: {', '.join(self.objects)}\n"
            f"  {', '.join(numbers) or 'no metrics'}, {len(self.fallbacks)} fallbacks)"
        )


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
) -> Result:
    """Turn one photograph into a scene that simulates (paper Figure 2).

    Every step reads the files of the steps before it and writes its own, so a run that is resumed
    goes through the same bytes as one that is not.

    Args:
        photo: the picture file.
        out: the run folder; new, empty, or a run to go on with.
        config: all options.
        until: stop after this step: parse, program, verify, compose, refine or export.
        resume: keep finished steps whose inputs have not changed.
        start: do this step and all after it again.
        overwrite: replace the run in `out`.
        record: tape file for the models' answers; they are kept in the run folder anyway.
        mailbox: folder for the provider `mailbox`; by default `mailbox` in the run folder.
        tapes: further tapes, or folders of tapes, for the provider `replay`.

    Raises:
        NeoWorldError: of the kind that names what is wrong: the photograph, the configuration, the
            folder, the models, or a program that did not become an object.
    """
    photo, out = _path(photo, "photo"), _path(out, "out")
    config = _checked(config)
    _check_request(until, resume, start, overwrite)
    picture = load_photo(photo, config.parse.max_side_px)
    open_models = partial(
        open_panel,
        config.mllm,
        config.provider,
        photo=picture.sha256,
        tapes=tapes,
        mailbox=mailbox or out / "mailbox",
        made=f"recorded from provider {config.provider}",
    )
    open_models()  # Report a wrong provider or key before the folder is touched.
    other_photo = _other_photo(out, picture)
    if other_photo and (resume or start is not None):
        raise RunError(
            f"{out} is a run of another photograph ({other_photo}), not of {photo}: go on with "
            "that one, replace the run with --overwrite, or name another folder"
        )
    with RunFolder(out, config, resume=resume, start=start, overwrite=overwrite) as run:
        run.record("photo", name=photo.name, sha256=picture.sha256)
        if other_photo:
            (run.path / ANSWERS).unlink(missing_ok=True)
        models = open_models(record=record or out / ANSWERS)
        if run.data["mllm"]:
            models.ledger.carry(run.data["mllm"])
        context = StepContext(run, config, picture, models)
        with models:
            try:
                for step in STEPS:
                    STEP_FUNCTIONS[step](context)
                    if step == until:
                        break
            finally:
                run.record("mllm", provider=models.name, **models.ledger.to_json())
        return _finish(run, until)


def refine_again(
    folder: Path | str, config: Config | None = None, over: dict[str, Any] | None = None
) -> Result:
    """Refine the composed scene of a run again, and export it; earlier steps are kept.

    Args:
        folder: the run folder; its compose step must have finished.
        config: all options; None takes those that the run was made with.
        over: a nested mapping of options that wins over the run's own, when `config` is None.

    Raises:
        RunError: the folder is no run, or its scene has not been composed yet.
    """
    folder = _path(folder, "folder")
    earlier = read_run(folder)
    if not (folder / COMPOSED).is_file():
        raise RunError(f"{folder} has no composed scene yet; go on with reconstruct --resume")
    if config is None:
        data = earlier["config"]
        # Header values are not written into run.json, and no model is asked here.
        data["mllm"]["headers"] = {}
        config = load_config(None, merged(data, over or {}))
    config = _checked(config)
    models = None
    if config.refine.semantic.scorer == "mllm":
        models = open_panel(
            config.mllm,
            config.provider,
            photo=earlier["photo"]["sha256"],
            mailbox=folder / "mailbox",
            record=folder / ANSWERS,
            made=f"recorded from provider {config.provider}",
        )
    with RunFolder(folder, config, start="refine") as run, models or nullcontext():
        context = StepContext(run, config, None, models)
        for step in ("refine", "export"):
            STEP_FUNCTIONS[step](context)
        return _finish(run, None)


def _path(value: object, name: str) -> Path:
    if isinstance(value, str | Path):
        return Path(value)
    raise ConfigError(f"{name} must be a path, got {type(value).__name__}")


def _checked(config: object) -> Config:
    if config is None:
        return Config()
    if isinstance(config, Config):
        return config
    raise ConfigError(
        f"config must be a Config, got {type(config).__name__}: "
        "make one with neoworld_mjx.config.load_config(overrides={...})"
    )


def _check_request(until: str | None, resume: bool, start: str | None, overwrite: bool) -> None:
    if overwrite and (resume or start is not None):
        other = "--resume" if resume else "--from"
        raise RunError(f"--overwrite begins anew and {other} goes on: give one of them")
    if start in STEPS and until in STEPS and STEPS.index(until) < STEPS.index(start):
        raise RunError(f"--until {until} comes before --from {start}: nothing would be done")


def _other_photo(out: Path, photo: Photo) -> str:
    """Return the name of the photograph that a folder's run is of, if it is another one."""
    try:
        if not (out / "run.json").is_file():
            return ""
    except OSError:
        return ""  # RunFolder reports it.
    earlier = read_run(out).get("photo", {})
    return earlier["name"] if earlier.get("sha256", photo.sha256) != photo.sha256 else ""


def _finish(run: RunFolder, until: str | None) -> Result:
    """Mark the run as finished, write its report and return its result."""
    from ..view.report import write_report

    run.finish(until)
    write_metrics(run)
    write_report(run.path)
    return Result(
        folder=run.path,
        until=until,
        metrics=run.data["metrics"],
        seconds=run.seconds(),
        fallbacks=run.data["fallbacks"],
        objects=[node.name for node in read_tree(run).nodes],
        passed=run.data["metrics"].get("passed"),
        cost=run.data["mllm"],
    )
