"""Context of the steps of a run, and the files that they share."""

from dataclasses import dataclass
from pathlib import Path

from ..checks.allowance import Allowance
from ..config import Config
from ..errors import SpecError
from ..io import read_model, read_object
from ..mllm import Panel
from ..parse.photo import Photo
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneTree
from .scene_pictures import Pictures

RESPONSE_TREE = "answered.json"
"""Scene tree of the model's response, before its fit to the 2D boxes."""
ANNOTATION = "annotation.json"
"""Annotation of the photograph by a person; missing if there is none."""
GIVEN = "given.json"
"""Scene as another method posed it; missing unless the run began with posed meshes."""
PHOTO = "photo.png"
TREE, COMPOSED, SCENE = "tree.json", "compose/scene.json", "scene.json"
CHECK = "compose/check.json"
REFIT = "compose/fit.json"
ALIGNED = "compose/align.json"
OUTLINES, EVIDENCE = "pictures/outlines.png", "pictures/evidence.png"
RESULT = "refine/result.json"
TAPE = "answers.tape.json"
VERIFIED_FILE = "verified.json"
"""Object after repairs by Step 3; missing if Step 3 did not change the object."""
REPROGRAMMED_FILE = "reprogrammed.py"
"""New program that Step 3 requested. It replaces program.py, and its synthesis is recorded in
reprogrammed.json."""

RESIZED_FILE = "resized.py"
"""Program whose dimensions Step 4 changed. It replaces the earlier programs, and resized.json
contains the object that it builds."""


@dataclass(frozen=True)
class StepContext:
    """The run folder, options, photograph and models of a run."""

    run: RunFolder
    config: Config
    photo: Photo | None
    """The photograph; None if the run starts after `program`."""
    models: Panel | None
    """The models; None if no step needs a model."""
    pictures: Pictures

    def photo_and_models(self) -> tuple[Photo, Panel]:
        """Return the photograph and the models, for steps that require them."""
        assert self.photo is not None and self.models is not None
        return self.photo, self.models


def read_tree(run: RunFolder, name: str = TREE) -> SceneTree:
    """Read the scene tree of Step 1: the fitted one, or `RESPONSE_TREE`."""
    return read_model(run.path / name, SceneTree, SpecError, "a scene tree")


def read_spec(path: Path) -> ObjectSpec:
    """Read the object that Step 2 or 3 wrote."""
    return read_model(path, ObjectSpec, SpecError, "an object")


def read_allowances(path: Path) -> list[Allowance]:
    """Return the overlaps that a program declares, from program.json."""
    try:
        return [Allowance(**entry) for entry in read_object(path, SpecError)["allowances"]]
    except (ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{path} contains no valid allowances of the program: {error}") from None
