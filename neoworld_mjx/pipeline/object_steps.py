"""Steps 1 to 3 of a run: parse the photograph, program the objects, verify them."""

import asyncio
import json
from collections.abc import Coroutine, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..compose.resting_pose import on_level, pose_without_scene
from ..config import ProgramOptions
from ..errors import ProgramError, SpecError
from ..io import read_object
from ..mllm.panel import run_coroutine
from ..parse.crops import Crop, SupportColour, crops, support_colours
from ..program.critique import Subject
from ..program.synthesise import ProgramSource, all_instructions, synthesise
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..verify.patch import write_patch
from ..verify.repairs import Repair
from ..verify.verification import verify_object
from .edited_files import build_edited, note_edited_program, program_edited
from .step_context import (
    PARSED,
    PARSED_PICTURE,
    PHOTO,
    PROGRAM,
    ROUNDS,
    SPEC,
    TREE,
    StepContext,
    object_file,
    object_files,
    read_allowances,
    read_spec,
    read_tree,
    write_files,
)

if TYPE_CHECKING:
    from ..evidence.evidence import Evidence


def parse_photo(context: StepContext) -> None:
    """Step 1: write tree.json, parse.json, photo.png and pictures/parse.png.

    If there are further photographs, a model then marks the objects in them (views/boxes.json).
    """
    from .further_photos import mark_objects
    from .given_evidence import kept_evidence, parse_inputs

    run, options = context.run, context.config.parse
    photo, known = context.photo_and_models()[0], kept_evidence(run)
    inputs = {"photo": photo.sha256, "options": options, **parse_inputs(context.evidence)}
    if not run.finished("parse", inputs):
        _parse(context, inputs, known)
    if known.further:
        mark_objects(context, read_tree(run, before="program"))


def _parse(context: StepContext, inputs: dict[str, object], known: "Evidence") -> None:
    """Ask for the scene in the photograph, and write the files of the step."""
    from ..evidence.consistency import check_distances
    from ..parse.parse import parse
    from ..render import to_png

    run, options = context.run, context.config.parse
    photo, models = context.photo_and_models()
    with run.step("parse", inputs) as out:
        assert out is not None
        parsed = run_coroutine(parse(photo, models, options, known))
        if known.depth is not None:
            check_distances(known.depth, parsed.tree)
        files: dict[str, str | bytes] = {
            TREE: parsed.tree.to_json(),
            PHOTO: to_png(photo.rgb),
            PARSED_PICTURE: parsed.picture,
            PARSED: parsed.to_json(),
        }
        write_files(out, files)
        for skipped, reason in parsed.fallbacks:
            run.fallback("parse", skipped, reason)


def program_objects(context: StepContext) -> None:
    """Step 2: write program.py, spec.json and program.json of all objects, in parallel.

    A known asset is written as spec.json, without a program.

    If programs are written in three stages, the parts of program.py are also written, as
    geometry.py, articulation.py and export.py. If models corrected measured boxes, tree.json is
    written again with the corrected sizes.
    """
    from .given_evidence import kept_evidence

    run, options = context.run, context.config.program
    photo, models = context.photo_and_models()
    tree, known = read_tree(run, before="program"), kept_evidence(run).objects
    known.check_names(tree)
    crop_by_name, colours = crops(photo, tree), support_colours(photo, tree)
    inputs = program_inputs(tree, crop_by_name, colours, options, known.assets)

    async def program_one(node: TreeNode) -> None:
        name, colour = f"program/{node.name}", colours.get(node.name)
        if run.finished(name, inputs[node.name]):
            return
        if node.name in known.assets:
            write_asset(run, name, node.name, known.assets[node.name], inputs[node.name])
            return
        run.begin(name)
        rgb = None if colour is None else colour.rgb
        subject = _subject(node, crop_by_name[node.name], tree)
        result = await synthesise(subject, models, options, colour=rgb)
        if result.spec is None:
            raise ProgramError(f"object {node.name}: {result.reason}")
        with run.step(name, inputs[node.name]) as out:
            assert out is not None
            write_files(out, object_files(node.name, result.files()))
            for skipped, reason in result.fallbacks:
                run.fallback(name, skipped, reason)
            if colour is not None and colour.source in ("answer", "material"):
                source = "response" if colour.source == "answer" else colour.source
                reason = f"only {colour.share:.1%} of the picture shows it"
                run.note(name, f"{node.name} has the color of its {source}", reason)
            if result.size is not None:
                sizes = (" x ".join(f"{v:.3f}" for v in s) for s in (node.box3d.size, result.size))
                reason = "{} m by the parse, {} m by the models".format(*sizes)
                run.note(name, f"{node.name} has a corrected size", reason)

    run_coroutine(_all_or_first_error(map(program_one, tree.nodes)))
    _correct_sizes(run, tree)


def _subject(node: TreeNode, crop: Crop, tree: SceneTree) -> Subject:
    return Subject(node, crop.picture, crop.note, tree.camera, crop.window)


def program_inputs(
    tree: SceneTree,
    crops: Mapping[str, Crop],
    colours: Mapping[str, SupportColour],
    options: ProgramOptions,
    assets: Mapping[str, ObjectSpec],
) -> dict[str, dict[str, object]]:
    """Return everything that determines the program of each object, by the object's name.

    An asset takes the place of a program.
    """
    return {
        node.name: {"asset": assets[node.name]}
        if node.name in assets
        else {
            "node": node.model_dump(mode="json"),
            "crop": crops[node.name].picture.pixels,
            "options": options.model_dump(mode="json"),
            "guide": all_instructions(options),
            "colour": None if node.name not in colours else colours[node.name].rgb,
        }
        for node in tree.nodes
    }


def write_asset(
    run: RunFolder, step: str, name: str, spec: ObjectSpec, inputs: Mapping[str, object]
) -> None:
    """Write the files of an object whose asset is known; it has no program."""
    with run.step(step, inputs) as out:
        if out is None:
            return
        rounds = json.dumps({"signals": [], "allowances": [], "rounds": []}, indent=1) + "\n"
        write_files(out, object_files(name, {SPEC: spec.to_json(), ROUNDS: rounds}))
        run.note(step, f"{name} is the given asset", "no model wrote a program for it")


def _correct_sizes(run: RunFolder, tree: SceneTree) -> None:
    """Write tree.json with the sizes of boxes that models corrected in Step 2."""
    sizes: dict[str, tuple[float, float, float]] = {}
    for node in tree.nodes:
        path = run.before("verify", object_file(node.name, ROUNDS))
        try:
            size = read_object(path, SpecError).get("size")
            if size is not None:
                x, y, z = size
                sizes[node.name] = (x, y, z)
        except (ValueError, TypeError) as error:
            raise SpecError(f"{path} contains no valid size: {error}") from None
    with run.step("program", {"tree": tree, "sizes": sizes}) as out:
        if out is not None and sizes:
            write_files(out, {TREE: tree.with_sizes(sizes).to_json()})


def verify_objects(context: StepContext) -> None:
    """Step 3: write each object's verify.json, and its changed files if it was changed.

    Known assets are tested, and not changed.

    These are spec.json, program.patch.json, which Step 3 applied to the object, and, if the critic
    asked for another program, program.py and program.json. Objects are simulated one after another,
    but their requests to models run concurrently.
    """
    from .given_evidence import kept_evidence

    run = context.run
    unchanged = context.config.verify.model_copy(update={"rounds": 0, "critic": "never"})
    tree, assets = read_tree(run, before="verify"), kept_evidence(run).objects.assets
    crop_by_name = {} if context.photo is None else crops(context.photo, tree)

    async def verify_one(node: TreeNode) -> None:
        name, level = f"verify/{node.name}", on_level(node, tree)
        known = node.name in assets
        options = unchanged if known else context.config.verify
        spec_file, rounds_file, program_file = (
            run.before("verify", object_file(node.name, file)) for file in (SPEC, ROUNDS, PROGRAM)
        )
        inputs: dict[str, object] = {
            "spec": spec_file,
            "program": rounds_file,
            "options": options,
            "node": node,
            "level": level,
            "surroundings": surroundings(node, tree),
        }
        edited = program_edited(run, node.name)
        if edited:
            inputs["edited"] = program_file
        if run.finished(name, inputs):
            return
        run.begin(name)
        built = build_edited(run, node.name, context.config.program) if edited else None
        spec = read_spec(spec_file) if built is None or built.spec is None else built.spec
        tilt, fixed_base = pose_without_scene(node, spec, level=level)
        source, crop = None, crop_by_name.get(node.name)
        kept = node.slab or known or edited
        if crop is not None and program_file.is_file() and not kept:
            text = program_file.read_text(encoding="utf-8")
            source = ProgramSource(_subject(node, crop, tree), text, context.config.program)
        result = await verify_object(
            spec,
            options,
            fixed_base=fixed_base,
            tilt=tilt,
            allowed=read_allowances(rounds_file) if built is None else built.allowances,
            models=None if options.critic == "never" else context.models,
            surroundings=surroundings(node, tree),
            source=source,
        )
        with run.step(name, inputs) as out:
            assert out is not None
            files = _changed_files(result)
            if built is not None:
                files.setdefault(SPEC, spec.to_json())
                note_edited_program(run, node.name, built)
            write_files(out, object_files(node.name, files))
            if not result.patch.empty:
                write_patch(out / object_file(node.name, PROGRAM), result.patch)
            _record_verification(run, node.name, result)

    run_coroutine(_all_or_first_error(map(verify_one, tree.nodes)))


def _changed_files(result: Repair) -> dict[str, str]:
    """Return the contents of verify.json and of the changed files of an object by file name."""
    files = {"verify.json": result.to_json()}
    if result.program is not None:
        files |= {PROGRAM: result.program.text, ROUNDS: result.program.to_json()}
    if result.changed:
        files[SPEC] = result.spec.to_json()
    return files


def _record_verification(run: RunFolder, name: str, result: Repair) -> None:
    """Record the outcome of the verification of an object in run.json."""
    step = f"verify/{name}"
    if result.program is not None:
        reason = "; ".join(result.seen) or "the critic asked for it"
        run.note(step, f"{name} has a new program", reason)
    if not result.patch.empty:
        run.note(step, f"{name} was edited", "; ".join(result.patch.changes()))
    if result.waived:
        phrases = "; ".join(check.phrase() for check in result.waived)
        run.note(step, f"{name} is valid according to the critic", phrases)
    for critic, reason in result.lost_critics:
        run.fallback(step, f"{name} without the response to {critic}", reason)
    for reason in result.unmet:
        run.fallback(
            step,
            f"{name} keeps its program, although the critic asks for another one",
            reason,
        )
    failed = [check for check in result.verdict.checks if check.failed]
    if failed:
        checks = [check.phrase() if check.outcome == "FAIL" else check.hint for check in failed]
        hints = dict.fromkeys(check.hint for check in failed if check.outcome == "FAIL")
        remedy = f"; to repair it: {next(iter(hints))}" if hints else ""
        run.fallback(
            step,
            f"{name} fails {len(failed)} of its object tests and is used as it is",
            "; ".join(checks) + remedy,
        )


def surroundings(node: TreeNode, tree: SceneTree) -> str:
    """Describe what supports an object in its scene, as a sentence; "" if nothing does."""
    if node.parent is None:
        return ""
    parent = tree.node(node.parent)
    relation = {
        "on": "rests on",
        "in": "stands or lies in",
        "attached": "is fastened to",
        "leaning": "stands on, and leans against something next to,",
    }[node.relation]
    return f"In the scene it {relation} {parent.name} ({parent.label})."


async def _all_or_first_error(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Run coroutines concurrently until all have ended, then raise the first error."""
    for error in await asyncio.gather(*work, return_exceptions=True):
        if isinstance(error, BaseException):
            raise error
