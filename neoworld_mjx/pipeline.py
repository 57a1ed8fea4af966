"""The five steps of the method, from a photograph to an exported scene, as one readable function.

Every step reads the files of the steps before it and writes its own, so a run that is resumed goes
through the same bytes as one that is not.
"""

import asyncio
import hashlib
import json
import logging
import time
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .config import Config, load_config, merged
from .errors import ProgramError, RunError, SpecError
from .mllm import Panel, Picture, open_panel
from .parse.photo import Photo, load_photo
from .program.allowance import Allowance
from .run_folder import STEPS, RunFolder, read_run
from .spec import ObjectSpec, SceneSpec, SceneTree, TreeNode

_log = logging.getLogger(__name__)

TREE, COMPOSED, SCENE = "tree.json", "compose/scene.json", "scene.json"
ANSWERS = "answers.tape.json"
VERIFIED = "verified.json"
"""The object as Step 3 hands it on, where that changed it."""


@dataclass(frozen=True)
class Result:
    """What a run has come to."""

    folder: Path
    until: str | None
    """The step it was asked to stop after; None for a whole run."""
    metrics: dict[str, Any]
    seconds: dict[str, float]
    fallbacks: list[dict[str, str]]
    objects: list[str]
    passed: bool | None
    """Whether the refined scene stands and does not intersect; None before refinement."""
    cost: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return the JSON object that `neoworld reconstruct --json` prints."""
        done = self.passed is not None and self.until is None
        return {
            "scene": str(self.folder / "scene.xml") if done else None,
            "folder": str(self.folder),
            "report": str(self.folder / "report.html"),
            "objects": self.objects,
            **{key: value for key, value in self.metrics.items() if key != "objects"},
            "passed": self.passed,
            "seconds": self.seconds,
            "fallbacks": self.fallbacks,
            "mllm": self.cost,
        }


def reconstruct(
    photo: Path,
    out: Path,
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
            folder, the models, or a program that did not come to an object.
    """
    config = config or Config()
    if overwrite and (resume or start is not None):
        other = "--resume" if resume else "--from"
        raise RunError(f"--overwrite begins anew and {other} goes on: give one of them")
    if start in STEPS and until in STEPS and STEPS.index(until) < STEPS.index(start):
        raise RunError(f"--until {until} comes before --from {start}: nothing would be done")
    picture = load_photo(photo, config.parse.max_side_px)
    asking = partial(
        open_panel,
        config.mllm,
        config.provider,
        photo=picture.sha256,
        tapes=tapes,
        mailbox=mailbox or Path(out) / "mailbox",
        made=f"recorded from provider {config.provider}",
    )
    asking()  # What is wrong with it is told before the folder is touched.
    another = _of_another_photo(Path(out), picture)
    if another and (resume or start is not None):
        raise RunError(
            f"{out} is a run of another photograph ({another}), not of {photo}: go on with that "
            "one, replace the run with --overwrite, or name another folder"
        )
    folder = RunFolder(out, config, resume=resume, start=start, overwrite=overwrite)
    with folder as run:
        run.record("photo", name=Path(photo).name, sha256=picture.sha256)
        if another:
            (run.path / ANSWERS).unlink(missing_ok=True)
        models = asking(record=record or Path(out) / ANSWERS)
        if run.data["mllm"]:
            models.ledger.carry(run.data["mllm"])
        steps = {
            "parse": lambda: _parse(run, picture, models, config),
            "program": lambda: _program(run, picture, models, config),
            "verify": lambda: _verify(run, models, config),
            "compose": lambda: _compose(run, config),
            "refine": lambda: _refine(run, config, models),
            "export": lambda: _export(run, config),
        }
        with models:
            try:
                for name, step in steps.items():
                    step()
                    if name == until:
                        break
            finally:
                run.record("mllm", provider=models.name, **models.ledger.to_json())
        run.finish(until)
        _report(run)
        return _result(run, until)


def refine_again(
    folder: Path, config: Config | None = None, over: dict[str, Any] | None = None
) -> Result:
    """Refine the composed scene of a run again, and export it; earlier steps are kept.

    Args:
        folder: the run folder; its compose step must have finished.
        config: all options; None takes those that the run was made with.
        over: a nested mapping of options that wins over the run's own, when `config` is None.

    Raises:
        RunError: the folder is no run, or its scene has not been composed yet.
    """
    folder = Path(folder)
    earlier = read_run(folder)
    if not (folder / COMPOSED).is_file():
        raise RunError(f"{folder} has no composed scene yet; go on with reconstruct --resume")
    if config is None:
        data = earlier["config"]
        # Header values are not written into run.json, and no model is asked here.
        data["mllm"]["headers"] = {}
        config = load_config(None, merged(data, over or {}))
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
        _refine(run, config, models)
        _export(run, config)
        run.finish()
        _report(run)
        return _result(run, None)


def _of_another_photo(out: Path, photo: Photo) -> str:
    """Return the name of the photograph that a folder's run is of, if it is another one."""
    try:
        if not (out / "run.json").is_file():
            return ""
    except OSError:
        return ""  # Told by the run folder.
    earlier = read_run(out).get("photo", {})
    return earlier["name"] if earlier.get("sha256", photo.sha256) != photo.sha256 else ""


def _parse(run: RunFolder, photo: Photo, models: Panel, config: Config) -> None:
    from .parse import parse
    from .render import to_png

    inputs = {"photo": photo.sha256, "options": config.parse}
    with run.step("parse", inputs) as out:
        if out is None:
            return
        found = asyncio.run(parse(photo, models, config.parse))
        (out / TREE).write_text(found.tree.to_json())
        (out / "photo.png").write_bytes(to_png(photo.rgb))
        (out / "pictures").mkdir()
        (out / "pictures" / "parse.png").write_bytes(found.picture)
        (out / "parse.json").write_text(found.to_json())
        for what, why in found.fallbacks:
            run.fallback("parse", what, why)


def _program(run: RunFolder, photo: Photo, models: Panel, config: Config) -> None:
    from .parse import crops
    from .program.synthesise import guide, synthesise

    tree = _tree(run)
    pictures = crops(photo, tree)
    inputs = {
        node.name: {
            "node": node.model_dump(mode="json"),
            "crop": hashlib.sha256(pictures[node.name].data).hexdigest(),
            "options": config.program.model_dump(mode="json"),
            "guide": guide(),
        }
        for node in tree.nodes
    }

    # Objects are programmed side by side; each is charged the time since the last was done, so that
    # their sum is the time that passed.
    mark = time.perf_counter()

    async def one(node: TreeNode) -> None:
        nonlocal mark
        name = f"program/{node.name}"
        if run.finished(name, inputs[node.name]):
            return
        made = await synthesise(
            node,
            pictures[node.name],
            models,
            config.program,
            camera=tree.camera,
            colour=pictures[node.name].colour,
        )
        if made.spec is None:
            raise ProgramError(f"object {node.name}: {made.reason}")
        with run.step(name, inputs[node.name], begun=mark) as out:
            assert out is not None
            home = out / "objects" / node.name
            home.mkdir(parents=True)
            (home / "program.py").write_text(made.text)
            (home / "spec.json").write_text(made.spec.to_json())
            (home / "program.json").write_text(made.to_json())
            for what, why in made.fallbacks:
                run.fallback(name, what, why)
        mark = time.perf_counter()

    async def everything() -> None:
        results = await asyncio.gather(*map(one, tree.nodes), return_exceptions=True)
        for error in results:  # All objects that could be made are kept before the first error.
            if isinstance(error, BaseException):
                raise error

    asyncio.run(everything())


def _verify(run: RunFolder, models: Panel, config: Config) -> None:
    from .compose.lying import alone, on_level
    from .verify import verify_and_repair, write_overlay

    tree = _tree(run)
    for node in tree.nodes:
        name = f"verify/{node.name}"
        home = run.path / "objects" / node.name
        spec, program = home / "spec.json", home / "program.json"
        level = on_level(node, tree)
        inputs = {"spec": spec, "program": program, "options": config.verify}
        with run.step(name, {**inputs, "node": node, "level": level}) as out:
            if out is None:
                continue
            made = _object(spec)
            tilt, held = alone(node, made, level=level)
            result = verify_and_repair(
                made,
                config.verify,
                fixed_base=held,
                tilt=tilt,
                allowed=_allowances(program),
                models=models if config.verify.critic else None,
            )
            home = out / "objects" / node.name
            home.mkdir(parents=True)
            (home / "verify.json").write_text(result.to_json())
            if not result.patch.empty:
                write_overlay(home / "program.py", result.patch)
                (home / VERIFIED).write_text(result.applied(made).to_json())
                run.fallback(name, f"{node.name} with edits", "; ".join(result.changes))
            for check in result.verdict.checks:
                if check.outcome in ("FAIL", "TOOL_FAILURE"):
                    what = f"{node.name} as it is, though {check.scenario}/{check.name} failed"
                    run.fallback(
                        name, what, f"{check.value} against {check.threshold}: {check.hint}"
                    )


def _compose(run: RunFolder, config: Config) -> None:
    from .compose import compose
    from .render import render_scene, to_png

    tree = _tree(run)
    specs = {}
    for node in tree.nodes:
        home = run.path / "objects" / node.name
        mended = home / VERIFIED
        specs[node.name] = mended if mended.is_file() else home / "spec.json"
    inputs = {"tree": run.path / TREE, "options": config.compose, "render": config.render, **specs}
    with run.step("compose", inputs) as out:
        if out is None:
            return
        made = compose(tree, {name: _object(path) for name, path in specs.items()}, config.compose)
        (out / "compose").mkdir()
        (out / COMPOSED).write_text(made.scene.to_json())
        (out / "compose" / "scales.json").write_text(json.dumps(made.scales, indent=1) + "\n")
        (out / "pictures").mkdir()
        shot = render_scene(
            made.scene, width=config.render.width, supersample=config.render.supersample
        )
        (out / "pictures" / "before.png").write_bytes(to_png(shot))
        for note in made.notes:
            run.fallback("compose", "a composition without it", note)


def _refine(run: RunFolder, config: Config, models: Panel | None) -> None:
    from .refinement import refine

    asked = config.refine.semantic.scorer == "mllm"
    photo = Picture.of("photo", load_photo(run.path / "photo.png").rgb) if asked else None

    inputs = {"scene": run.path / COMPOSED, "options": config.refine, "seed": config.seed}
    with run.step("refine", inputs) as out:
        if out is None:
            return
        scene = SceneSpec.model_validate_json((run.path / COMPOSED).read_text())
        (out / "refine").mkdir()
        found = refine(
            scene,
            config.refine,
            seed=config.seed,
            photo=photo,
            panel=models,
            scores=out / "refine" / "scores.jsonl" if asked else None,
            progress=lambda s: _log.info("  %s", s),
        )
        np.savez_compressed(out / "refine" / "history.npz", allow_pickle=False, **found.history)
        (out / SCENE).write_text(found.scene.to_json())
        told = {
            "passed": found.passed,
            "engine": found.engine,
            "iterations": found.iterations,
            "winner": list(found.winner),
            "finalists_tried": found.finalists_tried,
            "mean_log_scale": found.mean_log_scale,
            "mean_shift_m": found.mean_shift_m,
            "mean_turn_deg": found.mean_turn_deg,
            "rollouts": found.rollouts,
            "pruned": found.pruned,
            "scoring": found.scoring,
            "layout": {
                name: np.asarray(getattr(found.layout, name)[0]).tolist()
                for name in ("xy", "yaw", "log_scale")
            },
            "after": found.measure.model_dump(mode="json"),
            "before": found.before.model_dump(mode="json"),
        }
        (out / "refine" / "result.json").write_text(json.dumps(told, indent=1) + "\n")
        run.record("refine", seconds=found.seconds)
        for note in found.fallbacks:
            run.fallback("refine", "a scene that does not pass", note)


def _export(run: RunFolder, config: Config) -> None:
    from .export import export_scene
    from .render import render_scene, to_png

    inputs = {"scene": run.path / SCENE, "render": config.render}
    with run.step("export", inputs) as out:
        if out is None:
            return
        scene = _scene(run)
        export_scene(scene, out)
        # The refine step has written it already, and owns it.
        (out / SCENE).unlink(missing_ok=True)
        (out / "pictures").mkdir(exist_ok=True)
        shot = render_scene(scene, width=config.render.width, supersample=config.render.supersample)
        (out / "pictures" / "after.png").write_bytes(to_png(shot))


def _report(run: RunFolder) -> None:
    from .view.report import write_report

    path = run.path / "refine" / "result.json"
    if path.exists():
        told = json.loads(path.read_text())
        run.record(
            "metrics",
            **told["after"],
            mean_log_scale=told["mean_log_scale"],
            mean_shift_m=told["mean_shift_m"],
            mean_turn_deg=told["mean_turn_deg"],
            iterations=told["iterations"],
            engine=told["engine"],
            before=told["before"],
            passed=told["passed"],
        )
        run.save()
    write_report(run.path)


def _result(run: RunFolder, until: str | None) -> Result:
    metrics = run.data["metrics"]
    names = [node.name for node in _tree(run).nodes]
    return Result(
        folder=run.path,
        until=until,
        metrics=metrics,
        seconds=run.seconds(),
        fallbacks=run.data["fallbacks"],
        objects=names,
        passed=metrics.get("passed"),
        cost=run.data["mllm"],
    )


def _tree(run: RunFolder) -> SceneTree:
    return SceneTree.model_validate_json((run.path / TREE).read_text())


def _object(path: Path) -> ObjectSpec:
    try:
        return ObjectSpec.model_validate_json(path.read_text())
    except ValueError as error:
        raise SpecError(f"{path} is not an object: {error}") from None


def _allowances(path: Path) -> list[Allowance]:
    """Return the overlaps that a program declares, from what its step wrote down of it."""
    try:
        return [Allowance(**one) for one in json.loads(path.read_text())["allowances"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{path} lists no allowances of the program: {error}") from None


def _scene(run: RunFolder) -> SceneSpec:
    return SceneSpec.model_validate_json((run.path / SCENE).read_text())
