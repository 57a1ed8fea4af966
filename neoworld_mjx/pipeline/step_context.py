"""Context of the steps of a run: the files that they share, and pictures rendered in a thread."""

import contextlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from ..checks.signals import Allowance
from ..config import Config, RenderOptions
from ..errors import SpecError
from ..io import read_model, read_object
from ..mllm import Panel
from ..names import Step
from ..parse.photo import Photo
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneSpec, SceneTree, read_scene


class _Pending(NamedTuple):
    part: str
    inputs: dict[str, object]
    file: str
    png: Future[bytes]


@dataclass
class Pictures:
    """Pictures of a run. Use it in a `with` statement, which waits for unfinished pictures.

    Each picture is a part of a step, such as "compose/picture". Only the caller's thread writes to
    the run folder: `store` saves the pictures that have been rendered in the meantime.
    """

    run: RunFolder
    options: RenderOptions
    _pending: list[_Pending] = field(default_factory=list)
    _pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "pictures"))

    def begin(self, part: str, scene: Path, file: str) -> None:
        """Start to render a scene from its camera, unless the run already has this picture.

        Args:
            part: name of the picture as a part of a step.
            scene: file of the scene.
            file: path of the picture within the run folder.
        """
        inputs = {"scene": scene, "render": self.options}
        if not self.run.finished(part, inputs):
            future = self._pool.submit(_draw, read_scene(scene), self.options)
            self._pending.append(_Pending(part, inputs, file, future))

    def store(self, *, wait: bool = False) -> None:
        """Save the finished pictures in the run folder; if `wait` is True, save all pictures.

        The recorded duration of a part is the time that the run waited for it.
        """
        for pending in [p for p in self._pending if wait or p.png.done()]:
            self._pending.remove(pending)
            with self.run.step(pending.part, pending.inputs) as out:
                if out is not None:
                    (out / pending.file).parent.mkdir(parents=True, exist_ok=True)
                    (out / pending.file).write_bytes(pending.png.result())

    def __enter__(self) -> "Pictures":
        """Return this object."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Store pending pictures, even after an error, because they may show its cause."""
        try:
            if error is None:
                self.store(wait=True)
            elif isinstance(error, Exception):
                with contextlib.suppress(Exception):  # Report the first error.
                    self.store(wait=True)
        finally:
            self._pool.shutdown(wait=False, cancel_futures=True)


def _draw(scene: SceneSpec, options: RenderOptions) -> bytes:
    from ..render import render_scene, to_png

    return to_png(render_scene(scene, width=options.width, supersample=options.supersample))


RESPONSE_TREE = "history/response/tree.json"
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
DEPTH = "pictures/depth.png"
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
    pictures: Pictures
    evidence: dict[str, object] = field(default_factory=dict)
    """Inputs of the steps that use the evidence of the user; empty without evidence."""

    def photo_and_models(self) -> tuple[Photo, Panel]:
        """Return the photograph and the models, for steps that require them."""
        assert self.photo is not None and self.models is not None
        return self.photo, self.models


def read_tree(run: RunFolder, *, before: Step | None = None) -> SceneTree:
    """Read the scene tree of a run: the current tree, or the tree before a step changed it."""
    path = run.path / TREE if before is None else run.before(before, TREE)
    return read_model(path, SceneTree, SpecError, "a scene tree")


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
