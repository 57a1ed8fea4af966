"""Further photographs of a run: read from the user's files, kept, and marked by a model."""

from pathlib import Path

import numpy as np
from pydantic import Field

from ..errors import EvidenceError
from ..evidence.camera_files import camera_of_value, pose_of_value, read_camera
from ..evidence.depth_files import check_aspect
from ..evidence.evidence import Evidence
from ..evidence.evidence_file import StatedEvidence, StatedView, undistorted
from ..evidence.file_camera import FileCamera, Rows, intrinsics, rows_of
from ..evidence.further_photo import FurtherPhoto
from ..evidence.lens import Lens
from ..io import read_model
from ..io.names import repeated
from ..mllm.panel import run_coroutine
from ..parse.further_boxes import boxes_of_photo
from ..parse.photo import MODEL_MIN_SIDE_PX, Photo, load_photo
from ..spec import Box2D, SceneTree, Spec
from .step_context import StepContext, write_files

VIEWS = "views"
"""Folder of the further photographs in a run."""
LISTED, BOXES = "views.json", "boxes.json"
BOXES_PART = "parse/boxes"
"""Part of the step `parse` that keeps the boxes that a model marked."""


class _Kept(Spec):
    """Boxes and camera of a further photograph, as a run keeps them."""

    source: str
    boxes: dict[str, Box2D]
    focal: float | None = None
    principal: tuple[float, float] = (0.0, 0.0)
    to_first: Rows | None = None
    metric: bool = True


class _KeptViews(Spec):
    """Contents of views.json."""

    views: tuple[_Kept, ...]


class _KeptBoxes(Spec):
    """Contents of boxes.json: boxes by the number of the photograph and the object's name."""

    boxes: dict[str, dict[str, Box2D]] = Field(default_factory=dict)


def read_further(
    stated: StatedEvidence, photo: Photo, lens: Lens | None
) -> tuple[FurtherPhoto, ...]:
    """Read the further photographs that evidence states.

    Args:
        stated: the evidence, with paths from the working folder.
        photo: the first photograph.
        lens: its lens, if it has distortion.

    Raises:
        EvidenceError: a camera cannot be read, or contradicts its photograph.
        PhotoError: a photograph cannot be read.
    """
    names = [Path(view.photo).name for view in stated.views]
    if twice := repeated(names):
        raise EvidenceError(f"further photographs need different names: {', '.join(twice)}")
    return tuple(_read(view, stated, photo, lens) for view in stated.views)


def _read(
    view: StatedView, stated: StatedEvidence, first: Photo, lens: Lens | None
) -> FurtherPhoto:
    picture = load_photo(Path(view.photo), min_side_px=MODEL_MIN_SIDE_PX)
    name, rgb, focal, principal = picture.path.name, picture.rgb, None, (0.0, 0.0)
    if picture.sha256 == first.sha256:
        raise EvidenceError(f"{name} is the first photograph itself: give another one")
    if view.camera is None:
        width, height = picture.original_size
        check_aspect((height, width), first.original_size, f"{name}, without a camera of its own,")
    else:
        camera = _camera(view.camera, name)
        known, lens = intrinsics(camera, picture.original_size, name)
        if known.focal is None:
            raise EvidenceError(
                f"{name}: its camera states no focal length: give fx, fy, cx and cy, or omit camera"
            )
        scale = picture.size[0] / known.size[0]
        focal = known.focal * scale
        principal = (known.principal[0] * scale, known.principal[1] * scale)
    if lens is not None:
        shown = undistorted(Evidence(photo=rgb, lens=lens)).photo
        assert shown is not None
        rgb = shown
    boxes = {
        key: _box(f"{name}: box of {key}", corners, picture.scale)
        for key, corners in view.boxes.items()
    }
    to_first, metric = _relative_pose(view, stated, name, first.path.name)
    return FurtherPhoto(rgb, boxes, focal, principal, to_first, metric, name)


def _camera(value: str | dict[str, object], name: str) -> FileCamera:
    if isinstance(value, str):
        return read_camera(Path(value), name)
    return camera_of_value(value, Path(f"camera of {name}"), name).camera


def _box(what: str, corners: tuple[float, float, float, float], scale: float) -> Box2D:
    x0, y0, x1, y1 = (scale * value for value in corners)
    if not (x0 < x1 and y0 < y1):
        raise EvidenceError(f"{what}: expected left, top, right, bottom, got {list(corners)}")
    return Box2D(x0=x0, y0=y0, x1=x1, y1=y1)


def _relative_pose(
    view: StatedView, stated: StatedEvidence, name: str, first: str
) -> tuple[np.ndarray | None, bool]:
    """Return the pose of a camera relative to the first one, and whether its unit is the meter."""
    common, own = stated.base or stated.camera, view.camera or stated.camera
    if common is None or own is None:
        return None, True
    try:
        poses = pose_of_value(own, name), pose_of_value(common, first)
    except EvidenceError:
        if view.camera is not None:
            raise
        return None, True  # The file of the first camera does not list this photograph.
    if poses[0] is None or poses[1] is None or np.allclose(poses[0][0], poses[1][0]):
        return None, True
    return np.linalg.inv(poses[1][0]) @ poses[0][0], poses[0][1] and poses[1][1]


def further_files(photos: tuple[FurtherPhoto, ...]) -> dict[str, bytes]:
    """Return the contents of the files that keep further photographs, by path in a run folder."""
    from ..render import to_png

    if not photos:
        return {}
    kept = _KeptViews(
        views=tuple(
            _Kept(
                source=photo.source,
                boxes=dict(photo.boxes),
                focal=photo.focal,
                principal=photo.principal,
                to_first=None if photo.to_first is None else rows_of(photo.to_first),
                metric=photo.metric,
            )
            for photo in photos
        )
    )
    pictures = {f"{VIEWS}/{k}.png": to_png(photo.photo) for k, photo in enumerate(photos, 1)}
    listed = kept.model_dump_json(indent=1) + "\n"
    return {f"{VIEWS}/{LISTED}": listed.encode(), **pictures}


def kept_further(folder: Path, *, marked: bool = False) -> tuple[FurtherPhoto, ...]:
    """Return the further photographs in a run folder.

    Args:
        folder: the run folder.
        marked: if True, photographs without given boxes have those that a model marked.

    Raises:
        EvidenceError: a file is damaged.
    """
    file = folder / VIEWS / LISTED
    if not file.is_file():
        return ()
    views = read_model(file, _KeptViews, EvidenceError, "further photographs").views
    boxes: dict[str, dict[str, Box2D]] = {}
    if marked and (folder / VIEWS / BOXES).is_file():
        path = folder / VIEWS / BOXES
        boxes = read_model(path, _KeptBoxes, EvidenceError, "boxes of photographs").boxes
    return tuple(
        FurtherPhoto(
            load_photo(folder / VIEWS / f"{number}.png").rgb,
            kept.boxes or boxes.get(str(number), {}),
            kept.focal,
            kept.principal,
            None if kept.to_first is None else np.array(kept.to_first),
            kept.metric,
            kept.source,
        )
        for number, kept in enumerate(views, 1)
    )


def mark_objects(context: StepContext, tree: SceneTree) -> None:
    """Ask a model for the boxes of the objects in further photographs that have none.

    Args:
        context: the run, with the photograph and the models.
        tree: the scene tree of the first photograph.
    """
    run = context.run
    photo, models = context.photo_and_models()
    photos = kept_further(run.path)
    missing = [number for number, kept in enumerate(photos, 1) if not kept.boxes]
    if not missing:
        return
    objects = {node.name: [node.label, node.description] for node in tree.nodes}
    inputs: dict[str, object] = {"objects": objects, "photo": photo.sha256}
    inputs |= {f"view {n}": run.path / VIEWS / f"{n}.png" for n in missing}
    with run.step(BOXES_PART, inputs) as out:
        if out is None:
            return
        boxes = {}
        for number in missing:
            view, fallbacks = photos[number - 1], []
            boxes[str(number)] = run_coroutine(
                boxes_of_photo(photo, tree, view.photo, models, fallbacks)
            )
            for skipped, reason in fallbacks:
                run.fallback(BOXES_PART, f"{view.source} is not used: {skipped}", reason)
        text = _KeptBoxes(boxes=boxes).model_dump_json(indent=1) + "\n"
        write_files(out, {f"{VIEWS}/{BOXES}": text})
