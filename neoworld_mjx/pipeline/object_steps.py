"""Steps 1 to 3 of a run: parse the photograph, program the objects, verify them."""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, TypeVar

from ..errors import ProgramError
from ..mllm.coroutines import run_coroutine
from ..spec import TreeNode
from .program_inputs import program_inputs, with_corrected_sizes
from .step_context import (
    RESPONSE_TREE,
    TREE,
    StepContext,
    read_tree,
)

T = TypeVar("T")


def parse_photo(context: StepContext) -> None:
    """Step 1: write answered.json, tree.json, parse.json, photo.png and pictures/parse.png."""
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

    If programs are written in three stages, the parts of program.py are also written, as
    geometry.py, articulation.py and export.py.
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

    # The time of an object starts when the previous object finishes, so that times add up.
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
                source = "response" if colour.source == "answer" else colour.source
                reason = f"only {colour.share:.1%} of the picture shows it"
                run.note(name, f"{node.name} has the color of its {source}", reason)
            if result.size is not None:
                sizes = (" x ".join(f"{v:.3f}" for v in s) for s in (node.box3d.size, result.size))
                reason = "{} m by the parse, {} m by the models".format(*sizes)
                run.note(name, f"{node.name} has a corrected size", reason)
        last_finished = run.now()

    run_coroutine(_all_or_first_error(map(program_one, tree.nodes)))


def verify_objects(context: StepContext) -> None:
    """Step 3: write each object's verify.json, and the repaired object if it was changed.

    Objects are simulated one after another, but their requests to models run concurrently.
    """
    from ..parse.crops import crops
    from .object_verification import ObjectVerification

    tree = with_corrected_sizes(context.run, read_tree(context.run))
    crop_by_name = {} if context.photo is None else crops(context.photo, tree)
    # The time of an object starts when the previous object finishes, so that times add up.
    last_finished = context.run.now()

    async def verify_all() -> None:
        compute_lock = asyncio.Lock()

        async def compute(work: Callable[[], T]) -> T:
            async with compute_lock:
                return await asyncio.to_thread(work)

        async def verify_one(node: TreeNode) -> None:
            nonlocal last_finished
            verification = ObjectVerification(context, node, tree, crop_by_name.get(node.name))
            if context.run.finished(verification.name, verification.inputs):
                return
            result = await verification.result(compute)
            await compute(lambda: verification.write(result, last_finished))
            last_finished = context.run.now()

        await _all_or_first_error(verify_one(node) for node in tree.nodes)

    run_coroutine(verify_all())


async def _all_or_first_error(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Run coroutines concurrently until all have ended, then raise the first error."""
    for error in await asyncio.gather(*work, return_exceptions=True):
        if isinstance(error, BaseException):
            raise error
