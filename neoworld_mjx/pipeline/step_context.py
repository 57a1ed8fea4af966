"""Context of the steps of a run, and the files that they share."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..checks.signals import Allowance
from ..config import Config
from ..errors import SpecError
from ..io import read_model, read_object
from ..mllm import Panel
from ..names import Step
from ..parse.photo import Photo
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneTree, read_scene

ANNOTATION = "annotation.json"
"""Annotation of the photograph by a person; missing if there is none."""
GIVEN = "given.json"
"""Scene as another method posed it; missing unless the run began with posed meshes."""
PHOTO, PARSED, PARSED_PICTURE = "photo.png", "parse.json", "pictures/parse.png"
TREE, COMPOSED, SCENE = "tree.json", "compose/scene.json", "scene.json"
REFIT, SCALES = "compose/fit.json", "compose/scales.json"
ALIGNED = "compose/align.json"
OUTLINES, DEPTH = "pictures/outlines.png", "pictures/depth.png"
RESULT = "refine/result.json"
TAPE = "answers.tape.json"
PROGRAM, SPEC, ROUNDS = "program.py", "spec.json", "program.json"
"""Files of an object: its program, the object that it builds, and the rounds of its synthesis."""


@dataclass(frozen=True)
class StepContext:
    """The run folder, options, photograph and models of a run."""

    run: RunFolder
    config: Config
    photo: Photo | None
    """The photograph; None if the run starts after `program`."""
    models: Panel | None
    """The models; None if no step needs a model."""
    evidence: dict[str, object] = field(default_factory=dict)
    """Inputs of the steps that use the evidence of the user; empty without evidence."""

    def photo_and_models(self) -> tuple[Photo, Panel]:
        """Return the photograph and the models, for steps that require them."""
        assert self.photo is not None and self.models is not None
        return self.photo, self.models

    def draw(self, part: str, scene: str, file: str) -> None:
        """Render a scene from its camera, as a part of a step such as "compose/picture".

        Args:
            part: name of the picture as a part of a step.
            scene: file of the scene in the run folder.
            file: file of the picture in the run folder.
        """
        from ..render import render_scene, to_png

        path, options = self.run.path / scene, self.config.render
        with self.run.step(part, {"scene": path, "render": options}) as out:
            if out is not None:
                image = render_scene(
                    read_scene(path), width=options.width, supersample=options.supersample
                )
                write_files(out, {file: to_png(image)})


def read_tree(run: RunFolder, *, before: Step | None = None) -> SceneTree:
    """Read the scene tree of a run: the current tree, or the tree before a step changed it."""
    path = run.path / TREE if before is None else run.before(before, TREE)
    return read_model(path, SceneTree, SpecError, "a scene tree")


def write_files(out: Path, files: Mapping[str, str | bytes | Mapping[str, object]]) -> None:
    """Write files into the staging folder of a step.

    Args:
        out: the staging folder.
        files: contents by path in the run folder; a mapping is written as JSON.
    """
    for name, content in files.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Mapping):
            content = json.dumps(content, indent=1) + "\n"
        data = content.encode() if isinstance(content, str) else content
        (out / name).write_bytes(data)


def object_files(name: str, files: Mapping[str, str]) -> dict[str, str]:
    """Return the contents of an object's files by path in the run folder."""
    return {object_file(name, file): content for file, content in files.items()}


def object_file(name: str, file: str) -> str:
    """Return the path of a file of an object, relative to the run folder."""
    return f"objects/{name}/{file}"


def read_spec(path: Path) -> ObjectSpec:
    """Read an object that a step wrote."""
    return read_model(path, ObjectSpec, SpecError, "an object")


def read_allowances(path: Path) -> list[Allowance]:
    """Return the overlaps that a program declares, from program.json."""
    try:
        return [Allowance(**entry) for entry in read_object(path, SpecError)["allowances"]]
    except (ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{path} contains no valid allowances of the program: {error}") from None
