"""The steps of a run: each reads files of the run folder, calls its package and writes its files.

A step names everything that it reads as its inputs, so that the run folder can tell whether it has
to be done again.
"""

import asyncio
import hashlib
import json
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config import Config, RenderOptions
from ..errors import ProgramError, SpecError
from ..mllm import Panel, Picture
from ..parse.photo import Photo, load_photo
from ..program.allowance import Allowance
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneSpec, SceneTree, TreeNode

_log = logging.getLogger(__name__)

TREE, COMPOSED, SCENE = "tree.json", "compose/scene.json", "scene.json"
RESULT = "refine/result.json"
ANSWERS = "answers.tape.json"
VERIFIED = "verified.json"
"""The object as Step 3 repaired it; absent where Step 3 changed nothing."""


@dataclass(frozen=True)
class StepContext:
    """The run folder, options, photograph and models of a run."""

    run: RunFolder
    config: Config
    photo: Photo | None
    """None where the run begins after `program`."""
    models: Panel | None
    """None where no step needs a model."""

    def photo_and_models(self) -> tuple[Photo, Panel]:
        """Return both, in the steps that need them."""
        assert self.photo is not None and self.models is not None
        return self.photo, self.models


def parse_photo(context: StepContext) -> None:
    """Step 1: write tree.json, parse.json and the pictures of the parse."""
    from ..parse import parse
    from ..render import to_png

    run, options = context.run, context.config.parse
    photo, models = context.photo_and_models()
    with run.step("parse", {"photo": photo.sha256, "options": options}) as out:
        if out is None:
            return
        parsed = asyncio.run(parse(photo, models, options))
        (out / TREE).write_text(parsed.tree.to_json())
        (out / "photo.png").write_bytes(to_png(photo.rgb))
        (out / "pictures").mkdir()
        (out / "pictures" / "parse.png").write_bytes(parsed.picture)
        (out / "parse.json").write_text(parsed.to_json())
        for what, why in parsed.fallbacks:
            run.fallback("parse", what, why)


def program_objects(context: StepContext) -> None:
    """Step 2: write each object's program.py, spec.json and program.json, objects side by side."""
    from ..parse import crops
    from ..program.synthesise import guide, synthesise

    run, options = context.run, context.config.program
    photo, models = context.photo_and_models()
    tree = read_tree(run)
    pictures = crops(photo, tree)
    inputs = {
        node.name: {
            "node": node.model_dump(mode="json"),
            "crop": hashlib.sha256(pictures[node.name].data).hexdigest(),
            "options": options.model_dump(mode="json"),
            "guide": guide(),
        }
        for node in tree.nodes
    }

    # Each object is charged the time since the last one was done, so that their sum is the time
    # that passed.
    last_done = time.perf_counter()

    async def program_one(node: TreeNode) -> None:
        nonlocal last_done
        name, picture = f"program/{node.name}", pictures[node.name]
        if run.finished(name, inputs[node.name]):
            return
        answer = await synthesise(
            node, picture, models, options, camera=tree.camera, colour=picture.colour
        )
        if answer.spec is None:
            raise ProgramError(f"object {node.name}: {answer.reason}")
        with run.step(name, inputs[node.name], begun=last_done) as out:
            assert out is not None
            home = out / "objects" / node.name
            home.mkdir(parents=True)
            (home / "program.py").write_text(answer.text)
            (home / "spec.json").write_text(answer.spec.to_json())
            (home / "program.json").write_text(answer.to_json())
            for what, why in answer.fallbacks:
                run.fallback(name, what, why)
        last_done = time.perf_counter()

    async def program_all() -> None:
        results = await asyncio.gather(*map(program_one, tree.nodes), return_exceptions=True)
        for error in results:  # Objects that were programmed are kept before the first error.
            if isinstance(error, BaseException):
                raise error

    asyncio.run(program_all())


def verify_objects(context: StepContext) -> None:
    """Step 3: write each object's verify.json, and its repaired spec where a repair was needed."""
    tree = read_tree(context.run)
    for node in tree.nodes:
        _verify_object(context, node, tree)


def _verify_object(context: StepContext, node: TreeNode, tree: SceneTree) -> None:
    from ..compose.resting_pose import on_level, pose_without_scene
    from ..verify import verify_and_repair, write_overlay

    run, options = context.run, context.config.verify
    name = f"verify/{node.name}"
    home = run.path / "objects" / node.name
    spec, program = home / "spec.json", home / "program.json"
    level = on_level(node, tree)
    inputs = {"spec": spec, "program": program, "options": options, "node": node, "level": level}
    with run.step(name, inputs) as out:
        if out is None:
            return
        object_ = _read_object(spec)
        tilt, fixed_base = pose_without_scene(node, object_, level=level)
        result = verify_and_repair(
            object_,
            options,
            fixed_base=fixed_base,
            tilt=tilt,
            allowed=_read_allowances(program),
            models=context.models if options.critic else None,
        )
        home = out / "objects" / node.name
        home.mkdir(parents=True)
        (home / "verify.json").write_text(result.to_json())
        if not result.patch.empty:
            write_overlay(home / "program.py", result.patch)
            (home / VERIFIED).write_text(result.applied(object_).to_json())
            run.fallback(name, f"{node.name} with edits", "; ".join(result.changes))
        for check in result.verdict.checks:
            if check.outcome in ("FAIL", "TOOL_FAILURE"):
                what = f"{node.name} as it is, though {check.scenario}/{check.name} failed"
                run.fallback(name, what, f"{check.value} against {check.threshold}: {check.hint}")


def compose_scene(context: StepContext) -> None:
    """Step 4: write compose/scene.json, the scales of objects and a picture of the scene."""
    from ..compose import compose

    run, config = context.run, context.config
    tree = read_tree(run)
    specs = {}
    for node in tree.nodes:
        home = run.path / "objects" / node.name
        repaired = home / VERIFIED
        specs[node.name] = repaired if repaired.is_file() else home / "spec.json"
    inputs = {"tree": run.path / TREE, "options": config.compose, "render": config.render, **specs}
    with run.step("compose", inputs) as out:
        if out is None:
            return
        objects = {name: _read_object(path) for name, path in specs.items()}
        composed = compose(tree, objects, config.compose)
        (out / "compose").mkdir()
        (out / COMPOSED).write_text(composed.scene.to_json())
        (out / "compose" / "scales.json").write_text(json.dumps(composed.scales, indent=1) + "\n")
        _write_picture(composed.scene, config.render, out / "pictures" / "before.png")
        for note in composed.notes:
            run.fallback("compose", "a pose other than the parsed one", note)


def refine_layout(context: StepContext) -> None:
    """Step 5: write scene.json, and every candidate's layout and scores in refine/."""
    from ..refinement import refine

    run, config = context.run, context.config
    by_model = config.refine.semantic.scorer == "mllm"
    photo = Picture.of("photo", load_photo(run.path / "photo.png").rgb) if by_model else None
    inputs = {"scene": run.path / COMPOSED, "options": config.refine, "seed": config.seed}
    with run.step("refine", inputs) as out:
        if out is None:
            return
        (out / "refine").mkdir()
        refined = refine(
            SceneSpec.model_validate_json((run.path / COMPOSED).read_text()),
            config.refine,
            seed=config.seed,
            photo=photo,
            panel=context.models,
            scores=out / "refine" / "scores.jsonl" if by_model else None,
            progress=lambda line: _log.info("  %s", line),
        )
        np.savez_compressed(out / "refine" / "history.npz", allow_pickle=False, **refined.history)
        (out / SCENE).write_text(refined.scene.to_json())
        summary = {
            "passed": refined.passed,
            "engine": refined.engine,
            "iterations": refined.iterations,
            "winner": list(refined.winner),
            "finalists_tried": refined.finalists_tried,
            "mean_log_scale": refined.mean_log_scale,
            "mean_shift_m": refined.mean_shift_m,
            "mean_turn_deg": refined.mean_turn_deg,
            "rollouts": refined.rollouts,
            "pruned": refined.pruned,
            "scoring": refined.scoring,
            "layout": {
                name: np.asarray(getattr(refined.layout, name)[0]).tolist()
                for name in ("xy", "yaw", "log_scale")
            },
            "after": refined.measure.model_dump(mode="json"),
            "before": refined.before.model_dump(mode="json"),
        }
        (out / RESULT).write_text(json.dumps(summary, indent=1) + "\n")
        run.record("refine", seconds=refined.seconds)
        for note in refined.fallbacks:
            run.fallback("refine", "a refinement without it", note)


def export_files(context: StepContext) -> None:
    """Write the scene and its objects as MJCF, USD and URDF, and a picture of the scene."""
    from ..export import export_scene

    run, render = context.run, context.config.render
    with run.step("export", {"scene": run.path / SCENE, "render": render}) as out:
        if out is None:
            return
        scene = SceneSpec.model_validate_json((run.path / SCENE).read_text())
        export_scene(scene, out)
        (out / SCENE).unlink(missing_ok=True)  # The refine step has written it, and owns it.
        _write_picture(scene, render, out / "pictures" / "after.png")


STEP_FUNCTIONS: dict[str, Callable[[StepContext], None]] = {
    "parse": parse_photo,
    "program": program_objects,
    "verify": verify_objects,
    "compose": compose_scene,
    "refine": refine_layout,
    "export": export_files,
}
"""The function that does each of `run_folder.STEPS`."""


def write_metrics(run: RunFolder) -> None:
    """Record the metrics of the refined scene in run.json, if it is refined."""
    path = run.path / RESULT
    if not path.exists():
        return
    summary = json.loads(path.read_text())
    names = ("mean_log_scale", "mean_shift_m", "mean_turn_deg", "iterations", "engine", "before")
    own = {name: summary[name] for name in (*names, "passed")}
    run.record("metrics", **summary["after"], **own)
    run.save()


def read_tree(run: RunFolder) -> SceneTree:
    """Read the scene tree that Step 1 wrote."""
    return SceneTree.model_validate_json((run.path / TREE).read_text())


def _read_object(path: Path) -> ObjectSpec:
    try:
        return ObjectSpec.model_validate_json(path.read_text())
    except ValueError as error:
        raise SpecError(f"{path} is not an object: {error}") from None


def _read_allowances(path: Path) -> list[Allowance]:
    """Return the overlaps that a program declares, from the file that Step 2 wrote."""
    try:
        return [Allowance(**one) for one in json.loads(path.read_text())["allowances"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{path} lists no allowances of the program: {error}") from None


def _write_picture(scene: SceneSpec, options: RenderOptions, path: Path) -> None:
    from ..render import render_scene, to_png

    picture = render_scene(scene, width=options.width, supersample=options.supersample)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(to_png(picture))
