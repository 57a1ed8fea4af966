"""The steps of a run: each reads files of the run folder, calls its package and writes its files.

A step names everything that it reads as its inputs, so that the run folder can tell whether it has
to be done again.
"""

import asyncio
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import progress
from ..checks.allowance import Allowance
from ..config import Config
from ..errors import ProgramError, RunError, SpecError
from ..io import read_model, read_object
from ..mllm import Panel, Picture
from ..parse.photo import Photo, load_photo
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneTree, TreeNode, read_scene
from .coroutines import run_coroutine
from .pictures import Pictures
from .program_inputs import program_inputs, with_corrected_sizes

_log = logging.getLogger(__name__)

ANSWERED = "answered.json"
"""The tree before its fit to the boxes."""
ANNOTATION = "annotation.json"
"""What a person annotated, to be opened again."""
TREE, COMPOSED, SCENE = "tree.json", "compose/scene.json", "scene.json"
CHECK = "compose/check.json"
REFIT = "compose/fit.json"
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
    pictures: Pictures

    def photo_and_models(self) -> tuple[Photo, Panel]:
        """Return both, in the steps that need them."""
        assert self.photo is not None and self.models is not None
        return self.photo, self.models


def parse_photo(context: StepContext) -> None:
    """Step 1: write answered.json, tree.json, parse.json and the pictures of the parse."""
    from ..parse.parse import parse
    from ..render import to_png

    run, options = context.run, context.config.parse
    photo, models = context.photo_and_models()
    with run.step("parse", {"photo": photo.sha256, "options": options}) as out:
        if out is None:
            return
        parsed = run_coroutine(parse(photo, models, options))
        (out / TREE).write_text(parsed.tree.to_json(), encoding="utf-8")
        (out / ANSWERED).write_text(parsed.answered.to_json(), encoding="utf-8")
        (out / "photo.png").write_bytes(to_png(photo.rgb))
        (out / "pictures").mkdir()
        (out / "pictures" / "parse.png").write_bytes(parsed.picture)
        (out / "parse.json").write_text(parsed.to_json(), encoding="utf-8")
        for skipped, reason in parsed.fallbacks:
            run.fallback("parse", skipped, reason)
        for what, reason in () if parsed.fit is None else parsed.fit.notes():
            run.note("parse", what, reason)


def program_objects(context: StepContext) -> None:
    """Step 2: write each object's program.py, spec.json and program.json, objects side by side.

    With three stages geometry.py, articulation.py and export.py are the parts of program.py.
    """
    from ..parse.crops import crops
    from ..parse.support_colours import support_colours
    from ..program.synthesise import synthesise

    run, options = context.run, context.config.program
    photo, models = context.photo_and_models()
    tree = read_tree(run)
    pictures, colours = crops(photo, tree), support_colours(photo, tree)
    run.record("supports", **{name: colour._asdict() for name, colour in colours.items()})
    inputs = program_inputs(tree, pictures, colours, options)

    # Each object is charged the time since the one before was done: the sum is what passed.
    last_done = run.now()

    async def program_one(node: TreeNode) -> None:
        nonlocal last_done
        name, picture = f"program/{node.name}", pictures[node.name]
        colour = colours.get(node.name)
        if run.finished(name, inputs[node.name]):
            return
        answer = await synthesise(
            node,
            picture,
            models,
            options,
            camera=tree.camera,
            colour=None if colour is None else colour.rgb,
        )
        if answer.spec is None:
            raise ProgramError(f"object {node.name}: {answer.reason}")
        with run.step(name, inputs[node.name], begun=last_done) as out:
            assert out is not None
            home = out / "objects" / node.name
            home.mkdir(parents=True)
            (home / "program.py").write_text(answer.text, encoding="utf-8")
            if len(answer.texts) > 1:
                for file, text in answer.texts.items():
                    (home / f"{file}.py").write_text(text, encoding="utf-8")
            (home / "spec.json").write_text(answer.spec.to_json(), encoding="utf-8")
            (home / "program.json").write_text(answer.to_json(), encoding="utf-8")
            for skipped, reason in answer.fallbacks:
                run.fallback(name, skipped, reason)
            if colour is not None and colour.source in ("answer", "material"):
                why = f"the photograph shows it alone in {colour.share:.1%} of the picture"
                run.fallback(name, f"{node.name} in the colour of its {colour.source}", why)
            if answer.size is not None:
                sizes = (" x ".join(f"{v:.3f}" for v in s) for s in (node.box3d.size, answer.size))
                why = "{} m by the parse, {} m by the models".format(*sizes)
                run.fallback(name, f"{node.name} with a corrected size", why)
        last_done = run.now()

    async def program_all() -> None:
        results = await asyncio.gather(*map(program_one, tree.nodes), return_exceptions=True)
        for error in results:  # Objects that were programmed are kept before the first error.
            if isinstance(error, BaseException):
                raise error

    run_coroutine(program_all())


def verify_objects(context: StepContext) -> None:
    """Step 3: write each object's verify.json, and its repaired spec where a repair was needed."""
    tree = read_tree(context.run)
    for node in tree.nodes:
        _verify_object(context, node, tree)


def _verify_object(context: StepContext, node: TreeNode, tree: SceneTree) -> None:
    from ..checks.object_tests import run_object_tests
    from ..compose.resting_pose import on_level, pose_without_scene
    from ..verify import verify_and_repair
    from ..verify.films import films
    from ..verify.patch import write_overlay

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
            models=None if options.critic == "never" else context.models,
        )
        home = out / "objects" / node.name
        home.mkdir(parents=True)
        (home / "verify.json").write_text(result.to_json(), encoding="utf-8")
        verdict = result.verdict
        if options.films == "always" or (options.films == "questionable" and verdict.questionable):
            tests = run_object_tests(
                result.applied(object_),
                options,
                fixed_base=fixed_base,
                tilt=tilt,
                allowed=_read_allowances(program),
            )
            for kind, film in films(tests).items():
                (home / f"{kind}.gif").write_bytes(film)
        if not result.patch.empty:
            write_overlay(home / "program.py", result.patch)
            (home / VERIFIED).write_text(result.applied(object_).to_json(), encoding="utf-8")
            run.fallback(name, f"{node.name} with edits", "; ".join(result.changes))
        for asked, reason in result.lost_critics:
            run.fallback(name, f"{node.name} without the critic {asked}", reason)
        for check in result.verdict.checks:
            if check.outcome in ("FAIL", "TOOL_FAILURE"):
                fallback = f"{node.name} as it is, though {check.scenario}/{check.name} failed"
                why = f"{check.value} against {check.threshold}: {check.hint}"
                run.fallback(name, fallback, why)


def compose_scene(context: StepContext) -> None:
    """Step 4: fit the answer by the built shapes, compose the scene, and begin a picture of it.

    It writes compose/tree.json and compose/fit.json, compose/scene.json and the objects' scales.
    """
    from ..compose.compose import compose
    from ..compose.layout_patch import LAYOUT_PATCH, apply_layout, read_layout_patch
    from ..fit.refit import refit_tree
    from ..measure import shown_sides

    run, config = context.run, context.config
    tree = with_corrected_sizes(run, read_tree(run))
    specs = {}
    for node in tree.nodes:
        home = run.path / "objects" / node.name
        repaired = home / VERIFIED
        specs[node.name] = repaired if repaired.is_file() else home / "spec.json"
    refits = config.compose.refit and config.parse.fit
    by_hand = TREE in run.edited_by_hand("parse")
    # What a person says carries an object does.
    told = by_hand or (run.path / ANNOTATION).is_file()
    if refits and (run.path / ANSWERED).is_file() and not by_hand:
        # From the answer itself, since the fit by outlines has used the same boxes already.
        tree = with_corrected_sizes(run, read_tree(run, ANSWERED))
    inputs = {"tree": tree, "options": config.compose, "refits": refits, **specs}
    patch = read_layout_patch(run.path)
    if patch.objects:
        inputs["layout"] = patch
    with run.step("compose", inputs) as out:
        if out is not None:
            objects = {name: _read_object(path) for name, path in specs.items()}
            (out / "compose").mkdir()
            if refits:
                shown = shown_sides(compose(tree, objects, config.compose).scene)
                tree, report = refit_tree(tree, objects, shown, change_supports=not told)
                (out / "compose" / TREE).write_text(tree.to_json(), encoding="utf-8")
                (out / REFIT).write_text(
                    json.dumps(report.to_json(), indent=1) + "\n", encoding="utf-8"
                )
                for what, reason in report.notes():
                    run.note("compose", what, reason)
                for name, other in report.supports.items():
                    what = f"{name} {other.relation} {other.parent}, not {other.before}"
                    run.fallback("compose", what, other.phrase())
            composed = compose(tree, objects, config.compose)
            scene, stale = apply_layout(composed.scene, patch, config.compose.gap_m)
            (out / COMPOSED).write_text(scene.to_json(), encoding="utf-8")
            scales = json.dumps(composed.scales, indent=1) + "\n"
            (out / "compose" / "scales.json").write_text(scales, encoding="utf-8")
            for note in composed.notes:
                run.fallback("compose", "a scene other than the parsed one", note)
            for name in sorted(patch.objects.keys() - set(stale)):
                run.fallback("compose", f"{name} where a person put it", f"{LAYOUT_PATCH} says so")
            for name in stale:
                why = f"{LAYOUT_PATCH} names it, the scene lacks it"
                run.fallback("compose", f"no {name}", why)
    context.pictures.begin("compose/picture", run.path / COMPOSED, "pictures/before.png")
    _check_composed(context)


def _check_composed(context: StepContext) -> None:
    """Tell which objects of the composed scene move, before any search; write compose/check.json.

    What nothing can hold in any layout is a fallback of the run; the search may cure the others.
    """
    from ..measure import measured, unstable_objects
    from ..measure.unstable import phrases

    run, limits = context.run, context.config.refine
    bounds = limits.model_dump(
        include={"check_duration_s", "check_timestep_s", "max_depth_m", "max_drift_m"}
        | {"max_tilt_deg"}
    )
    with run.step("compose/check", {"scene": run.path / COMPOSED, "bounds": bounds}) as out:
        if out is None:
            return
        scene = read_scene(run.path / COMPOSED)
        measure = measured(scene, limits)
        moving = unstable_objects(
            scene, measure, max_drift=limits.max_drift_m, max_tilt=limits.max_tilt_deg
        )
        entries = [json.loads(e.model_dump_json()) | {"phrase": e.phrase()} for e in moving]
        (out / CHECK).parent.mkdir()
        text = json.dumps({"unstable": entries}, indent=1) + "\n"
        (out / CHECK).write_text(text, encoding="utf-8")
        if moving:
            _log.warning("compose: before the search %s", phrases(moving))
        for entry in moving:
            if not entry.held:
                run.fallback(
                    "compose/check", f"{entry.name} without anything to hold it", entry.why
                )


def refine_layout(context: StepContext) -> None:
    """Step 5: write scene.json, and every candidate's layout and scores in refine/."""
    from ..fit.fit_report import NOTED_M, NOTED_SIZE
    from ..measure import box_iou, object_moves
    from ..refinement import refine

    run, config = context.run, context.config
    by_model = config.refine.semantic.scorer == "mllm"
    photo = Picture.of("photo", load_photo(run.path / "photo.png").rgb) if by_model else None
    inputs = {"scene": run.path / COMPOSED, "options": config.refine, "seed": config.seed}

    def report(line: str) -> None:
        progress.report(f"  {line}")
        context.pictures.store()

    with run.step("refine", inputs) as out:
        if out is None:
            return
        (out / "refine").mkdir()
        composed = read_scene(run.path / COMPOSED)
        refined = refine(
            composed,
            config.refine,
            seed=config.seed,
            photo=photo,
            panel=context.models,
            scores=out / "refine" / "scores.jsonl" if by_model else None,
            progress=report,
        )
        np.savez_compressed(out / "refine" / "history.npz", allow_pickle=False, **refined.history)
        (out / SCENE).write_text(refined.scene.to_json(), encoding="utf-8")
        summary = {
            "passed": refined.passed,
            "engine": refined.engine,
            "iterations": refined.iterations,
            "winner": list(refined.winner),
            "finalists_tried": refined.finalists_tried,
            "mean_log_scale": refined.mean_log_scale,
            "mean_shift_m": refined.mean_shift_m,
            "mean_turn_deg": refined.mean_turn_deg,
            "kept": list(refined.kept),
            "rollouts": refined.rollouts,
            "pruned": refined.pruned,
            "scoring": refined.scoring,
            "layout": {
                name: np.asarray(getattr(refined.layout, name)[0]).tolist()
                for name in ("xy", "yaw", "log_scale")
            },
            "after": refined.measure.model_dump(mode="json"),
            "before": refined.before.model_dump(mode="json"),
            "box_iou": box_iou(read_tree(run), composed, refined.scene),
        }
        (out / RESULT).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
        run.record("refine", seconds=refined.seconds)
        for note in refined.fallbacks:
            run.fallback("refine", "a refinement without it", note)
        for name, move in object_moves(composed, refined.scene).items():
            if move.distance_m > NOTED_M or abs(move.size_ratio - 1) > NOTED_SIZE:
                run.note(
                    "refine",
                    f"{name} other than composed",
                    f"the search moved it by {100 * move.distance_m:.0f} cm, scaled it by "
                    f"{move.size_ratio:.2f} and turned it by {move.yaw_deg:.0f} deg",
                )


def export_files(context: StepContext) -> None:
    """Write the scene and its objects as MJCF, USD and URDF, and a picture of the scene."""
    from ..export import export_scene

    run = context.run
    context.pictures.begin("export/picture", run.path / SCENE, "pictures/after.png")
    with run.step("export", {"scene": run.path / SCENE}) as out:
        if out is None:
            return
        export_scene(read_scene(run.path / SCENE), out)
        (out / SCENE).unlink(missing_ok=True)  # The refine step has written it, and owns it.


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
    summary = read_object(path, RunError)
    names = ("mean_log_scale", "mean_shift_m", "mean_turn_deg", "iterations", "engine", "before")
    try:
        own = {name: summary[name] for name in (*names, "passed")}
        own["box_iou"] = summary.get("box_iou")
        run.record("metrics", **summary["after"], **own)
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} lacks {error}; do the step again with --from refine") from None
    run.save()


def read_tree(run: RunFolder, name: str = TREE) -> SceneTree:
    """Read the scene tree that Step 1 wrote, or with `ANSWERED` that of the answer."""
    return read_model(run.path / name, SceneTree, SpecError, "a scene tree")


def _read_object(path: Path) -> ObjectSpec:
    return read_model(path, ObjectSpec, SpecError, "an object")


def _read_allowances(path: Path) -> list[Allowance]:
    """Return the overlaps that a program declares, from the file that Step 2 wrote."""
    try:
        return [Allowance(**entry) for entry in read_object(path, SpecError)["allowances"]]
    except (ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{path} lists no allowances of the program: {error}") from None
