"""Write an annotation as the first two steps of a run; run the later steps without a model."""

from dataclasses import replace
from pathlib import Path

from ..config import Config
from ..errors import ProgramError, RunError, SpecError
from ..evidence.known_camera import EXACT_FOCAL, KnownCamera
from ..io import bounded_by, read_model
from ..parse.crops import colour_in_box, crops, support_colours
from ..parse.draw import draw_parse
from ..program import build
from ..program.ask import written_without_model
from ..program.supports import support_program
from ..render import to_png
from ..run_folder import Result, RunFolder
from ..spec import SceneTree, TreeNode
from ..view.annotated_tree import annotated_tree, annotation_from_tree, program_of
from ..view.annotation import EXISTING_PROGRAM, WRITTEN_BY_MODEL, Annotation
from .given_evidence import Given, keep_evidence, kept_inputs, known_photo, parse_inputs
from .object_steps import program_inputs, write_asset
from .reconstruction import finish, run_steps
from .step_context import (
    ANNOTATION,
    PARSED,
    PARSED_PICTURE,
    PHOTO,
    PROGRAM,
    ROUNDS,
    SPEC,
    TREE,
    object_files,
    write_files,
)

Files = dict[str, str]
"""Contents of an object's files, by file name."""
_STAGE_FILES = ("geometry.py", "articulation.py", "export.py")
_PROGRAM_FILES = (PROGRAM, SPEC, ROUNDS)


def read_annotation(folder: Path) -> Annotation:
    """Return the annotation of a run: annotation.json, or one derived from tree.json.

    Raises:
        RunError: the folder contains neither file.
        SpecError: the file is damaged.
    """
    if (folder / ANNOTATION).is_file():
        return read_model(folder / ANNOTATION, Annotation, SpecError, "an annotation")
    if (folder / TREE).is_file():
        return annotation_from_tree(read_model(folder / TREE, SceneTree, SpecError, "a scene tree"))
    raise RunError(f"{folder} contains no {TREE}: omit --from parse to start with an empty page")


def write_annotated(
    photo: Path,
    out: Path,
    annotation: Annotation,
    config: Config,
    *,
    simulate: bool = True,
    evidence: Given | None = None,
) -> Result:
    """Write the tree and the programs of an annotation into a run folder.

    If the folder contains a run of this photograph, objects of the kind `EXISTING_PROGRAM` keep
    their programs. Everything else is repeated.

    Args:
        photo: the image file.
        out: the run folder: new, empty, or with a run of this photograph.
        annotation: the annotation.
        config: all options.
        simulate: if True, also verify, compose, refine and export. If a model has to write a
            program, the run stops before these steps, and `neoworld reconstruct --resume` continues
            it.
        evidence: as for `reconstruct`. Calibrated values replace those of the annotation's camera.

    Raises:
        NeoWorldError: the annotation has no valid tree, a program fails, or a step fails.
    """
    with bounded_by(config.files):
        exists = (out / "run.json").is_file()
        picture, known = known_photo(photo, config, evidence, out if exists else None)
        annotation = _calibrated(annotation, known.evidence.camera)
        objects = known.evidence.objects
        tree = objects.applied(annotated_tree(annotation))
        objects.check_names(tree)
        by_name = {obj.name: obj for obj in annotation.objects}
        colours, crop_by_name = support_colours(picture, tree), crops(picture, tree)
        texts: dict[str, Files] = {}
        for node in tree.nodes:
            obj = by_name.get(node.name)
            if node.name in objects.assets:
                continue
            if node.slab:
                rgb = colours[node.name].rgb if node.name in colours else None
                texts[node.name] = _build_files(node, support_program(node, rgb), "support", config)
            elif obj is not None and obj.kind == EXISTING_PROGRAM:
                texts[node.name] = _read_files(out / "objects" / node.name)
            elif obj is not None:
                rgb = colour_in_box(picture, tree, node)
                text = program_of(obj, node.box3d.size, rgb)
                if text is not None:
                    texts[node.name] = _build_files(node, text, "annotation", config)
        with RunFolder(out, config, "redo" if exists else "new", step="parse") as run:
            run.record("photo", name=photo.name, sha256=picture.sha256)
            keep_evidence(run, known)
            inputs = {"photo": picture.sha256, "options": config.parse}
            inputs |= parse_inputs(kept_inputs(run))
            with run.step("parse", inputs) as step:
                assert step is not None
                files: dict[str, str | bytes] = {
                    TREE: tree.to_json(),
                    ANNOTATION: annotation.model_dump_json(indent=1) + "\n",
                    PHOTO: to_png(picture.rgb),
                    PARSED_PICTURE: draw_parse(picture, tree, draw_3d_boxes=True).data,
                    PARSED: '{"rounds": []}\n',
                }
                write_files(step, files)
            program = program_inputs(tree, crop_by_name, colours, config.program, objects.assets)
            for name, texts_of_object in texts.items():
                with run.step(f"program/{name}", program[name]) as step:
                    if step is not None:
                        write_files(step, object_files(name, texts_of_object))
            for name, spec in objects.assets.items():
                write_asset(run, f"program/{name}", name, spec, program[name])
            left_to_model = [
                name
                for name, obj in by_name.items()
                if obj.kind == WRITTEN_BY_MODEL and name not in objects.assets
            ]
            if simulate and not left_to_model:
                run_steps(run, config, None, first="verify")
                return finish(run, None)
            return finish(run, "parse" if left_to_model else "program")


def _calibrated(annotation: Annotation, known: KnownCamera | None) -> Annotation:
    """Return the annotation with the camera's known values, except for a focal length of EXIF."""
    if known is None:
        return annotation
    if known.focal_sd > EXACT_FOCAL:
        known = replace(known, focal=None)
    return annotation.model_copy(update={"camera": known.camera(annotation.camera)})


def _build_files(node: TreeNode, text: str, stage: str, config: Config) -> Files:
    """Build a program, and return the contents of the object's files by name."""
    built = build(text, config.program)
    if built.spec is None:
        reasons = "; ".join(signal.phrase() for signal in built.signals[:3])
        raise ProgramError(f"object {node.name}: {reasons}")
    return written_without_model(stage, text, built).files()


def _read_files(object_folder: Path) -> Files:
    missing = [name for name in _PROGRAM_FILES if not (object_folder / name).is_file()]
    if missing:
        raise RunError(
            f"{object_folder} contains no {missing[0]}: choose another kind for the object, or "
            "leave it to a model"
        )
    names = [name for name in (*_PROGRAM_FILES, *_STAGE_FILES) if (object_folder / name).is_file()]
    return {name: (object_folder / name).read_text(encoding="utf-8") for name in names}
