"""Reconstruct a photograph (paper Figure 2), or refine the composed scene of a run again."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from ..config import Config, load_config, merged
from ..errors import ConfigError, RunError
from ..io import bounded_by
from ..mllm import Panel, open_panel
from ..parse.photo import Photo, load_photo
from ..run_folder import STEPS, Result, RunFolder, read_run
from .pictures import Pictures
from .steps import ANSWERS, COMPOSED, STEP_FUNCTIONS, StepContext, read_tree, write_metrics


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
    with bounded_by(config.files):
        return _reconstructed(
            *(photo, out, config, until, resume, start, overwrite, record, mailbox, tapes)
        )


def _reconstructed(
    photo: Path,
    out: Path,
    config: Config,
    until: str | None,
    resume: bool,
    start: str | None,
    overwrite: bool,
    record: Path | None,
    mailbox: Path | None,
    tapes: tuple[Path, ...],
) -> Result:
    picture = load_photo(photo, config.parse.max_side_px, config.parse.min_side_px)
    open_models = partial(
        open_panel,
        config.mllm,
        config.provider,
        photo=picture.sha256,
        tapes=tapes,
        mailbox=mailbox or out / "mailbox",
        made=f"recorded from provider {config.provider}",
    )
    if config.program.language == "blender" and until != "parse":
        from ..program.blender.blender_availability import require_blender

        require_blender()
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
        with _booked(run, models), Pictures(run, config.render) as pictures:
            context = StepContext(run, config, picture, models, pictures)
            for step in STEPS:
                STEP_FUNCTIONS[step](context)
                pictures.store()
                if step == until:
                    break
        return finish(run, until)


@contextmanager
def _booked(run: RunFolder, models: Panel | None) -> Iterator[None]:
    """Let models go on with the run's ledger, so that its cap holds, and write it down at the end.

    Raises:
        RunError: the run's ledger is damaged.
    """
    if models is None:
        yield
        return
    if run.data["mllm"]:
        try:
            models.ledger.carry(run.data["mllm"])
        except (AttributeError, LookupError, TypeError, ValueError):
            raise RunError(
                f"{run.path / 'run.json'}: the costs under mllm are damaged: mend them, or begin "
                "anew with --overwrite"
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
        config = earlier_options(folder, earlier["config"], over or {})
    config = _checked(config)
    with bounded_by(config.files):
        return _refined_again(folder, config, earlier)


def earlier_options(
    folder: Path, data: dict[str, Any], over: dict[str, Any], *, verifies: bool = False
) -> Config:
    """Return the options of an earlier run, which may come from a stranger.

    Args:
        folder: the run folder.
        data: options in its run.json.
        over: options that win over them.
        verifies: whether objects will be verified, so that a critic may be asked.

    Raises:
        ConfigError: they are none, or name code to run or a server to send a key to.
    """
    # Header values are not written into run.json.
    mllm = data.get("mllm")
    headers = mllm.get("headers") if isinstance(mllm, dict) else None
    if isinstance(mllm, dict):
        data = data | {"mllm": {key: mllm[key] for key in mllm if key != "headers"}}
    try:
        config = load_config(None, merged(data, over))
    except ConfigError as error:
        raise ConfigError(f"{folder / 'run.json'}: {error}; give options by --config") from None
    named = [name for name in config.refine.reward.terms if ":" in name]
    named += [config.refine.optimizer] * (":" in config.refine.optimizer)
    if named:
        raise ConfigError(
            f"{folder / 'run.json'} names code of your own to run ({', '.join(named)}): if you "
            "trust it, give the option yourself by --config or --set"
        )
    asks = config.refine.semantic.scorer == "mllm" or (
        verifies and config.verify.critic == "always"
    )
    if asks and headers and not config.mllm.headers:
        raise ConfigError(
            f"{folder / 'run.json'} does not keep what was in the headers {', '.join(headers)}: "
            "give mllm.headers again by --config or --set"
        )
    if asks and (config.mllm.base_url is not None or config.mllm.prices is not None):
        raise ConfigError(
            f"{folder / 'run.json'} names a server for models ({config.mllm.base_url}), which "
            "would get your key: if you trust it, give mllm.base_url yourself by --config or --set"
        )
    return config


def _refined_again(folder: Path, config: Config, earlier: dict[str, Any]) -> Result:
    models = models_of_run(folder, config, earlier, critic=False)
    with RunFolder(folder, config, start="refine") as run:
        return steps_from(run, "refine", config, models)


def models_of_run(
    folder: Path, config: Config, earlier: dict[str, Any], *, critic: bool
) -> Panel | None:
    """Open the models that the steps after `program` ask; None if they ask none.

    Args:
        folder: the run folder.
        config: its options.
        earlier: its run.json.
        critic: whether verify is among these steps. A critic that is not to see every object
            is not asked: a person has edited what it would judge.
    """
    if config.refine.semantic.scorer == "mllm" or (critic and config.verify.critic == "always"):
        return open_panel(
            config.mllm,
            config.provider,
            photo=earlier["photo"].get("sha256"),
            mailbox=folder / "mailbox",
            record=folder / ANSWERS,
            made=f"recorded from provider {config.provider}",
        )
    return None


def steps_from(run: RunFolder, first: str, config: Config, models: Panel | None) -> Result:
    """Do a step that needs no photograph, and all after it."""
    with _booked(run, models), Pictures(run, config.render) as pictures:
        context = StepContext(run, config, None, models, pictures)
        for step in STEPS[STEPS.index(first) :]:
            STEP_FUNCTIONS[step](context)
            pictures.store()
    return finish(run, None)


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
    earlier = read_run(out)["photo"]
    if earlier.get("sha256", photo.sha256) == photo.sha256:
        return ""
    return earlier.get("name") or "of an unknown name"


def finish(run: RunFolder, until: str | None) -> Result:
    """Mark the run as finished, write its report and return its result."""
    from ..view.report.run_report import write_report

    run.finish(until)
    write_metrics(run)
    write_report(run.path)
    return Result(
        folder=run.path,
        until=until,
        metrics=run.data["metrics"],
        seconds=run.seconds(),
        waiting=run.waiting(),
        fallbacks=run.data["fallbacks"],
        notes=run.data["notes"],
        objects=[node.name for node in read_tree(run).nodes],
        passed=run.data["metrics"].get("passed"),
        cost=run.data["mllm"],
    )
