"""Steps 1 to 3 of a run: parse the photograph, program the objects, verify them."""

import asyncio

from ..errors import ProgramError
from ..spec import SceneTree, TreeNode
from .coroutines import run_coroutine
from .program_inputs import program_inputs
from .step_context import (
    RESPONSE_TREE,
    TREE,
    VERIFIED,
    StepContext,
    read_allowances,
    read_spec,
    read_tree,
)


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
        (out / RESPONSE_TREE).write_text(parsed.response_tree.to_json(), encoding="utf-8")
        (out / "photo.png").write_bytes(to_png(photo.rgb))
        (out / "pictures").mkdir()
        (out / "pictures" / "parse.png").write_bytes(parsed.picture)
        (out / "parse.json").write_text(parsed.to_json(), encoding="utf-8")
        for skipped, reason in parsed.fallbacks:
            run.fallback("parse", skipped, reason)
        for outcome, reason in () if parsed.fit is None else parsed.fit.notes():
            run.note("parse", outcome, reason)


def program_objects(context: StepContext) -> None:
    """Step 2: write program.py, spec.json and program.json of all objects, in parallel.

    With three stages, geometry.py, articulation.py and export.py are the parts of program.py.
    """
    from ..parse.crops import crops
    from ..parse.support_colours import support_colours
    from ..program.synthesise import synthesise

    run, options = context.run, context.config.program
    photo, models = context.photo_and_models()
    tree = read_tree(run)
    crop_by_name, colours = crops(photo, tree), support_colours(photo, tree)
    run.record("supports", **{name: colour._asdict() for name, colour in colours.items()})
    inputs = program_inputs(tree, crop_by_name, colours, options)

    # An object's time counts from when the previous one finished, so the times add up.
    last_finished = run.now()

    async def program_one(node: TreeNode) -> None:
        nonlocal last_finished
        name, crop = f"program/{node.name}", crop_by_name[node.name]
        colour = colours.get(node.name)
        if run.finished(name, inputs[node.name]):
            return
        result = await synthesise(
            node,
            crop,
            models,
            options,
            camera=tree.camera,
            colour=None if colour is None else colour.rgb,
        )
        if result.spec is None:
            raise ProgramError(f"object {node.name}: {result.reason}")
        with run.step(name, inputs[node.name], started=last_finished) as out:
            assert out is not None
            object_folder = out / "objects" / node.name
            object_folder.mkdir(parents=True)
            (object_folder / "program.py").write_text(result.text, encoding="utf-8")
            if len(result.texts) > 1:
                for file, text in result.texts.items():
                    (object_folder / f"{file}.py").write_text(text, encoding="utf-8")
            (object_folder / "spec.json").write_text(result.spec.to_json(), encoding="utf-8")
            (object_folder / "program.json").write_text(result.to_json(), encoding="utf-8")
            for skipped, reason in result.fallbacks:
                run.fallback(name, skipped, reason)
            if colour is not None and colour.source in ("answer", "material"):
                reason = f"it is unoccluded in only {colour.share:.1%} of the picture"
                run.fallback(name, f"{node.name} in the colour of its {colour.source}", reason)
            if result.size is not None:
                sizes = (" x ".join(f"{v:.3f}" for v in s) for s in (node.box3d.size, result.size))
                reason = "{} m by the parse, {} m by the models".format(*sizes)
                run.fallback(name, f"{node.name} with a corrected size", reason)
        last_finished = run.now()

    async def program_all() -> None:
        results = await asyncio.gather(*map(program_one, tree.nodes), return_exceptions=True)
        for error in results:  # Keep all finished objects, then raise the first error.
            if isinstance(error, BaseException):
                raise error

    run_coroutine(program_all())


def verify_objects(context: StepContext) -> None:
    """Step 3: write each object's verify.json, and its repaired spec if repairs were needed."""
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
    object_folder = run.path / "objects" / node.name
    spec, program = object_folder / "spec.json", object_folder / "program.json"
    level = on_level(node, tree)
    inputs = {"spec": spec, "program": program, "options": options, "node": node, "level": level}
    with run.step(name, inputs) as out:
        if out is None:
            return
        object_ = read_spec(spec)
        tilt, fixed_base = pose_without_scene(node, object_, level=level)
        result = verify_and_repair(
            object_,
            options,
            fixed_base=fixed_base,
            tilt=tilt,
            allowed=read_allowances(program),
            models=None if options.critic == "never" else context.models,
        )
        object_folder = out / "objects" / node.name
        object_folder.mkdir(parents=True)
        (object_folder / "verify.json").write_text(result.to_json(), encoding="utf-8")
        verdict = result.verdict
        if options.films == "always" or (options.films == "questionable" and verdict.questionable):
            tests = run_object_tests(
                result.applied(object_),
                options,
                fixed_base=fixed_base,
                tilt=tilt,
                allowed=read_allowances(program),
            )
            for kind, film in films(tests).items():
                (object_folder / f"{kind}.gif").write_bytes(film)
        if not result.patch.empty:
            write_overlay(object_folder / "program.py", result.patch)
            (object_folder / VERIFIED).write_text(
                result.applied(object_).to_json(), encoding="utf-8"
            )
            run.fallback(name, f"{node.name} with edits", "; ".join(result.changes))
        for critic, reason in result.lost_critics:
            run.fallback(name, f"{node.name} without the critic {critic}", reason)
        for check in result.verdict.checks:
            if check.outcome in ("FAIL", "TOOL_FAILURE"):
                fallback = f"{node.name} unchanged, although {check.scenario}/{check.name} failed"
                reason = f"{check.value} against {check.threshold}: {check.hint}"
                run.fallback(name, fallback, reason)
