"""Evidence as a user states it: one file that names a camera, images, and known objects."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, ValidationError

from ..errors import EvidenceError
from ..io.text_files import read_yaml, validation_message
from ..spec import Spec
from ..spec.base import Name, Number, Vec3
from .camera_files import camera_of_value, read_base, read_camera
from .consistency import check_evidence
from .depth_files import check_aspect, read_depth, registered
from .depth_image import DepthImage, DepthKind
from .evidence import Evidence, PhotoPixels
from .file_camera import FileCamera, Rows, known_camera, photo_lens, rigid_problem
from .known_objects import KnownObjects, KnownSize
from .lens import pinhole_of, undistorted_image
from .mask_files import read_masks
from .masks import Masks

OWN_CAMERA = "the scene's file"
"""Source of a camera that the user does not state."""
MAX_VIEWS = 20
"""Largest number of further photographs."""


def _located(path: str, info: Any) -> str:  # pydantic's type of `info` cannot be checked.
    """Return a path as the context of the validation places it; unchanged without a context."""
    return path if info.context is None else info.context(path)


FilePath = Annotated[str, AfterValidator(_located)]
"""Path of a file or folder that evidence names."""
ShortPath = Annotated[str, Field(max_length=400), AfterValidator(_located)]
"""The same, as only a file states it."""


class StatedDepth(Spec):
    """A depth image in an evidence file."""

    file: ShortPath
    scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Meters per unit; by default .001 for an image, and 1 for an array."""
    kind: DepthKind = "metric"
    confidence: ShortPath | None = None
    """Image of the same size, from 0 to 1."""
    error: float | None = Field(default=None, ge=0, le=1)
    """Standard deviation of errors that neighboring pixels share, relative to the depth; by default
    .03 for affine depth and disparity, and 0 for metric depth."""
    camera: ShortPath | None = None
    """Camera of a sensor next to the photograph's camera; if not stated, the depth image shows the
    photograph's view."""
    to_photo: Rows | None = None
    """Transform from the sensor's frame to that of the photograph's camera (OpenCV) [m]."""


class StatedMasks(Spec):
    """Masks in an evidence file."""

    file: ShortPath
    names: ShortPath | None = None
    """JSON file with the number of each object."""


class StatedView(Spec):
    """A further photograph in an evidence file."""

    photo: ShortPath
    camera: FilePath | dict[str, object] | None = None
    """Its camera, with a pose in the same frame as that of the first photograph if it is known; by
    default, the file of the first photograph's camera, if it lists this photograph."""
    boxes: dict[Name, tuple[Number, Number, Number, Number]] = Field(default_factory=dict)
    """Left, top, right and bottom of the objects' 2D boxes [px], by name; without any, a model is
    asked for them."""


class StatedEvidence(Spec):
    """Contents of an evidence file. Paths are relative to the file."""

    camera: FilePath | dict[str, object] | None = None
    """Camera file, or the camera itself."""
    base: FilePath | dict[str, object] | None = None
    """File with the pose of the camera in the base frame, or the pose itself."""
    gravity: Vec3 | None = None
    """Direction of gravity, in the camera's frame (OpenCV)."""
    ground: Number | None = None
    """Height of the scene's plane z = 0 in the base frame [m]."""
    depth: FilePath | StatedDepth | None = None
    masks: FilePath | StatedMasks | None = None
    views: tuple[StatedView, ...] = Field(default=(), max_length=MAX_VIEWS)
    """Further photographs of the scene."""
    objects: dict[Name, FilePath] = Field(default_factory=dict)
    """Files of assets that take the place of programs, by name of the object."""
    sizes: dict[Name, KnownSize] = Field(default_factory=dict)
    """Known sizes, by name of the object."""
    keep: tuple[Name, ...] = ()
    """Names of objects that stay where the parse, the annotation or the scene's file has them."""
    check: bool = True
    """False if a depth image is used although its edges are not those of the photograph."""

    @property
    def of_photo(self) -> bool:
        """True if something is stated of a photograph, and not only of objects."""
        names = ("camera", "base", "gravity", "ground", "depth", "masks")
        return bool(self.views) or any(getattr(self, name) is not None for name in names)

    def overridden(self, other: "StatedEvidence") -> "StatedEvidence":
        """Return a copy in which the stated values of another one take precedence.

        Assets and further photographs of both are used.
        """
        update = {name: getattr(other, name) for name in other.model_fields_set}
        both = {"objects": self.objects | other.objects, "views": (*self.views, *other.views)}
        return self.model_copy(update=update | both)


def read_stated(path: Path, check: Callable[[str], object] = str) -> StatedEvidence:
    """Read an evidence file (YAML or JSON), with its paths relative to the working folder.

    Args:
        path: the file.
        check: called with each of these paths; it may raise an error to refuse one.

    Raises:
        EvidenceError: the file cannot be read, or is no evidence file.
    """
    path = Path(path)

    def at(file: str) -> str:
        located = str(path.parent / file)
        check(located)
        return located

    try:
        stated = read_yaml(path, "evidence", EvidenceError)
        return StatedEvidence.model_validate(stated, context=at)
    except ValidationError as error:
        reason = validation_message(error, StatedEvidence)[:600]
        raise EvidenceError(f"{path} is no evidence file: {reason}") from None


def evidence_of(
    stated: StatedEvidence,
    photo: str,
    rgb: PhotoPixels,
    size: tuple[int, int],
    own: FileCamera | None = None,
) -> Evidence:
    """Read the files of stated evidence, and check them against the photograph.

    Args:
        stated: the evidence, with paths from the working folder.
        photo: name of the photograph, which chooses among the images of a camera file.
        rgb: the photograph (sRGB), at any size.
        size: width and height of the upright photograph [px].
        own: camera in the file of a scene, which completes the stated one.

    Returns:
        The evidence, without the photograph and without assets. Its images are those of `lens`, if
        there is one.

    Raises:
        EvidenceError: a file cannot be read, or contradicts the photograph.
    """
    camera, source = stated_camera(stated, photo)
    if own is not None:
        camera, source = (camera or FileCamera()).completed_by(own), source or OWN_CAMERA
    known, lens = (None, None) if camera is None else known_camera(camera, size, source)
    depth = None
    if stated.depth is not None:
        depth = _depth(stated.depth, camera, size, source)
        check_aspect(depth.values.shape, size, depth.source)
    masks = None
    if stated.masks is not None:
        given = stated.masks
        given = StatedMasks(file=given) if isinstance(given, str) else given
        masks = read_masks(Path(given.file), None if given.names is None else Path(given.names))
        check_aspect(masks.labels.shape, size, masks.source)
    objects = KnownObjects(sizes=stated.sizes, keep=stated.keep)
    evidence = Evidence(camera=known, depth=depth, masks=masks, lens=lens, objects=objects)
    check_evidence(evidence, rgb, edges=stated.check)
    return evidence


def stated_camera(stated: StatedEvidence, photo: str) -> tuple[FileCamera | None, str]:
    """Return the stated camera, completed by base frame and gravity, and its source.

    Args:
        stated: the evidence.
        photo: name of the photograph, which chooses among the images of a camera file.

    Raises:
        EvidenceError: a file cannot be read, or is no camera.
    """
    camera, sources = None, []
    if stated.camera is not None:
        camera, source = _read(stated.camera, photo, base=False)
        sources.append(source)
    if stated.base is not None:
        base, source = _read(stated.base, photo, base=True)
        sources.append(source)
        names = ("pose", "axes", "ground", "gravity")
        values = {name: getattr(base, name) for name in names if name in base.model_fields_set}
        camera = base if camera is None else camera.model_copy(update=values)
    if stated.gravity is not None:
        gravity = np.array(stated.gravity, float)
        if camera is not None and camera.axes == "opengl":
            gravity = gravity * [1, -1, -1]
        values = {"gravity": tuple(gravity.tolist())}
        camera = _validated((camera or FileCamera()).model_copy(update=values))
        sources.append("gravity")
    if stated.ground is not None:
        if camera is None or camera.pose is None:
            raise EvidenceError(
                "ground is a height in the base frame: give the pose of the camera by base"
            )
        camera = camera.model_copy(update={"ground": stated.ground})
    return camera, " and ".join(dict.fromkeys(sources))


def _read(value: str | dict[str, object], photo: str, *, base: bool) -> tuple[FileCamera, str]:
    if isinstance(value, dict):
        name = "base" if base else "camera"
        return camera_of_value(value, Path(name), photo).camera, name
    path = Path(value)
    return (read_base if base else read_camera)(path, photo), path.name


def _validated(camera: FileCamera) -> FileCamera:
    try:
        return FileCamera.model_validate(camera.model_dump(exclude_none=True))
    except ValidationError as error:
        raise EvidenceError(validation_message(error, FileCamera)[:600]) from None


def _depth(
    stated: str | StatedDepth, camera: FileCamera | None, size: tuple[int, int], source: str
) -> DepthImage:
    given = StatedDepth(file=stated) if isinstance(stated, str) else stated
    scale = given.scale
    image = Path(given.file).suffix.lower() not in (".npy", ".npz")
    if scale is None and image and camera is not None and camera.depth_scale is not None:
        scale = camera.depth_scale / 1000
    depth = read_depth(
        Path(given.file),
        scale=scale,
        kind=given.kind,
        confidence=None if given.confidence is None else Path(given.confidence),
        smooth_sd=given.error,
    )
    if given.camera is None and given.to_photo is None:
        return depth
    if given.camera is None or given.to_photo is None:
        raise EvidenceError(
            f"{depth.source}: give both camera and to_photo of a sensor next to the camera, or "
            "neither"
        )
    if problem := rigid_problem(np.array(given.to_photo)):
        raise EvidenceError(f"{depth.source}: to_photo: {problem}")
    rows, columns = depth.values.shape
    sensor_file = read_camera(Path(given.camera))
    sensor = photo_lens(sensor_file, (columns, rows), Path(given.camera).name)
    photo = None if camera is None else photo_lens(camera, size, source)
    if sensor is None or photo is None:
        raise EvidenceError(
            f"{depth.source}: a sensor next to the camera needs fx, fy, cx and cy of both cameras"
        )
    return registered(depth, sensor, np.array(given.to_photo), photo)


def undistorted(evidence: Evidence) -> Evidence:
    """Return the evidence with undistorted images, which `evidence.camera` describes."""
    lens = evidence.lens
    if lens is None:
        return evidence
    pinhole = pinhole_of(lens)
    photo, depth, masks = evidence.photo, evidence.depth, evidence.masks
    if photo is not None:
        photo = undistorted_image(photo, lens, pinhole, smooth=True)
    if depth is not None:
        trust = depth.confidence
        depth = replace(
            depth,
            values=undistorted_image(depth.values, lens, pinhole),
            confidence=None if trust is None else undistorted_image(trust, lens, pinhole),
        )
    if masks is not None:
        masks = Masks(undistorted_image(masks.labels, lens, pinhole), masks.names, masks.source)
    return replace(evidence, photo=photo, depth=depth, masks=masks, lens=None)
