"""Readers of the files in which calibrated cameras are kept.

| file | contents |
|---|---|
| .json, .yaml | `FileCamera`; `width height ppx ppy fx fy model coeffs` of librealsense, too |
| .yaml, .json | `camera_info` of ROS: camera_matrix or K, D, distortion_model |
| .json | BOP: camera.json, or scene_camera.json with cam_K by image number |
| .json | nerfstudio: transforms.json with frames by file |
| folder, .txt | COLMAP: cameras.txt, and images.txt beside it |
| .npy, .txt, .csv | the 3 x 3 matrix K, or the 4 x 4 matrix of a pose |

The poses of BOP, nerfstudio and COLMAP lead to a world of their own, whose z need not be vertical
and whose unit need not be the meter. They count only where a file is given as the base frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import ValidationError

from ..errors import EvidenceError
from ..io import read_arrays, read_json, read_untrusted_text
from ..io.text_files import read_yaml, validation_message
from .file_camera import FileCamera, Rows, rows_of

POSE_HELP = (
    "give the 4 x 4 transform from the camera to the base frame, as pose of a JSON or YAML file, "
    "or as .npy or .txt"
)
ROS_MODELS = {
    "plumb_bob": "brown_conrady",
    "rational_polynomial": "brown_conrady",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
}
REALSENSE_MODELS = {"none": "", "brown_conrady": "brown_conrady", "f_theta": "fisheye"}
COLMAP_MODELS: dict[str, tuple[str, str]] = {
    "SIMPLE_PINHOLE": ("", "f cx cy"),
    "PINHOLE": ("", "fx fy cx cy"),
    "SIMPLE_RADIAL": ("brown_conrady", "f cx cy k1"),
    "RADIAL": ("brown_conrady", "f cx cy k1 k2"),
    "OPENCV": ("brown_conrady", "fx fy cx cy k1 k2 p1 p2"),
    "FULL_OPENCV": ("brown_conrady", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", "f cx cy k1"),
    "RADIAL_FISHEYE": ("fisheye", "f cx cy k1 k2"),
    "OPENCV_FISHEYE": ("fisheye", "fx fy cx cy k1 k2 k3 k4"),
}
"""Lens model and names of the parameters of COLMAP's models."""
_SHOWN = 5


@dataclass(frozen=True)
class CameraFile:
    """Contents of a camera's file."""

    camera: FileCamera
    world: Rows | None = None
    """Pose in the file's own world, with OpenCV's axes; None if the file states none."""


def read_camera(path: Path, photo: str = "") -> FileCamera:
    """Read a camera from a file in any of the formats of this module.

    Args:
        path: the file, or a folder with COLMAP's text files.
        photo: name of the photograph, which chooses among the images of a file.

    Raises:
        EvidenceError: the file cannot be read, or is no camera, or the photograph is not in it.
    """
    return read_camera_file(path, photo).camera


def read_base(path: Path, photo: str = "") -> FileCamera:
    """Read the pose of a camera in a base frame, and `ground` and `gravity` if they are stated.

    Args:
        path: a file as for `read_camera`, or a 4 x 4 matrix.
        photo: name of the photograph.

    Raises:
        EvidenceError: the file cannot be read, or states no pose.
    """
    read = read_camera_file(path, photo)
    if read.camera.pose is not None:
        return read.camera
    if read.world is None:
        raise EvidenceError(f"{path} states no pose: {POSE_HELP}")
    return _checked({"pose": read.world, "ground": read.camera.ground}, path)


def read_camera_file(path: Path, photo: str = "") -> CameraFile:
    """Read a camera, and its pose in the file's own world; see `read_camera`."""
    path = Path(path)
    if path.is_dir():
        return _colmap(path, photo)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _matrix(read_arrays(path, EvidenceError)[""], path)
    if suffix in (".txt", ".csv"):
        if path.name in ("cameras.txt", "images.txt"):
            return _colmap(path.parent, photo)
        return _matrix(_numbers(read_untrusted_text(path, EvidenceError, "camera"), path), path)
    if suffix == ".json":
        value = read_json(path, EvidenceError, "camera")
    elif suffix in (".yaml", ".yml"):
        value = read_yaml(path, "camera", EvidenceError)
    else:
        raise EvidenceError(
            f"{path}: a camera is a .json, .yaml, .npy, .txt or .csv file, or a folder of COLMAP"
        )
    return camera_of_value(value, path, photo)


def pose_of_value(
    value: str | dict[str, object], photo: str
) -> tuple[Float[np.ndarray, "4 4"], bool] | None:
    """Return the pose that a camera's file or value states, and whether it is in meters.

    Args:
        value: path of the file, or the camera itself.
        photo: name of the photograph.

    Returns:
        The transform from the camera's frame (OpenCV) to the frame in which the pose is stated;
        None without a pose.
    """
    if isinstance(value, dict):
        read = camera_of_value(value, Path("camera"), photo)
    else:
        read = read_camera_file(Path(value), photo)
    if (matrix := read.camera.matrix()) is not None:
        return matrix, True
    return None if read.world is None else (np.array(read.world), False)


def camera_of_value(value: object, path: Path, photo: str = "") -> CameraFile:
    """Return the camera that a JSON or YAML value states; see `read_camera_file`."""
    if isinstance(value, list):
        return _matrix(_array(value, path), path)
    if not isinstance(value, dict):
        raise EvidenceError(f"{path} is not a camera: it holds a {type(value).__name__}")
    try:
        if "camera_matrix" in value or "K" in value or "k" in value:
            return CameraFile(_ros(value, path))
        if "frames" in value or "camera_angle_x" in value:
            return _nerfstudio(value, path, photo)
        if "ppx" in value:
            return CameraFile(_realsense(value, path))
        if "cam_K" in value or any(isinstance(v, dict) and "cam_K" in v for v in value.values()):
            return _bop(value, path, photo)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise EvidenceError(f"{path} is not a camera: {reason}") from None
    return CameraFile(_checked(value, path))


def _checked(value: object, path: Path) -> FileCamera:
    try:
        return FileCamera.model_validate(value)
    except ValidationError as error:
        reason = validation_message(error, FileCamera)[:600]
        raise EvidenceError(f"{path} is not a camera: {reason}") from None


def _with_lens(
    size: tuple[Any, Any] | None,
    focal: Sequence[float],
    center: Sequence[float],
    distortion: tuple[str, Sequence[float]],
    path: Path,
) -> FileCamera:
    """Return a camera; `center` is in OpenCV's convention."""
    fx, fy = map(float, focal)
    cx, cy = map(float, center)
    value: dict[str, object] = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
    if size is not None:
        value |= {"width": int(size[0]), "height": int(size[1])}
    model, coefficients = distortion
    if any(coefficients) or model == "fisheye":
        value["distortion"] = {"model": model, "coefficients": [float(k) for k in coefficients]}
    return _checked(value, path)


def _numbers(text: str, path: Path) -> NDArray:
    rows = [line.replace(",", " ").split() for line in text.splitlines() if line.strip()]
    return _array(rows, path)


def _array(value: object, path: Path) -> NDArray:
    try:
        return np.array(value, float)
    except (TypeError, ValueError):
        raise EvidenceError(f"{path} is not a matrix of numbers") from None


def _matrix(matrix: NDArray, path: Path) -> CameraFile:
    """Read the 3 x 3 matrix of intrinsics, or the 4 x 4 matrix of a pose."""
    if matrix.dtype.kind not in "fiu" or not np.isfinite(matrix).all():
        raise EvidenceError(f"{path} is not a matrix of finite numbers")
    if matrix.size == 9:
        k = matrix.reshape(3, 3)
        if abs(k[2] - [0, 0, 1]).max() > 1e-6 or abs(k[1, 0]) > 1e-6:
            hint = "its rows and columns are swapped" if abs(k[:2, 2]).max() < 1e-6 else "it is"
            raise EvidenceError(f"{path} is no matrix K (fx 0 cx, 0 fy cy, 0 0 1): {hint} {k}")
        return CameraFile(_with_lens(None, (k[0, 0], k[1, 1]), k[:2, 2].tolist(), ("", ()), path))
    if matrix.shape == (4, 4) or matrix.size == 16:
        pose = _checked({"pose": rows_of(matrix.reshape(4, 4))}, path)
        return CameraFile(pose)
    raise EvidenceError(f"{path} has the shape {matrix.shape}; K is 3 x 3, a pose 4 x 4")


def _ros(value: Mapping[str, Any], path: Path) -> FileCamera:
    matrix = value.get("camera_matrix", value.get("K", value.get("k")))
    k = _flat(matrix)
    if len(k) != 9:
        raise ValueError(f"its matrix K has {len(k)} numbers")
    name = value.get("distortion_model", value.get("camera_model", "plumb_bob"))
    coefficients = _flat(value.get("distortion_coefficients", value.get("D", value.get("d", []))))
    model = ROS_MODELS.get(name, "")
    if not model and any(coefficients):
        raise ValueError(f"distortion_model {name!r}; choices: {', '.join(ROS_MODELS)}")
    size = (value.get("image_width", value.get("width")),
            value.get("image_height", value.get("height")))  # fmt: skip
    given = None if None in size else size
    return _with_lens(given, (k[0], k[4]), (k[2], k[5]), (model, coefficients), path)


def _flat(value: Any) -> list[float]:
    """Return the numbers of a matrix: nested lists, or a mapping with `data`."""
    if isinstance(value, dict):
        value = value["data"]
    return np.ravel(np.array(value, float)).tolist()


def _realsense(value: Mapping[str, Any], path: Path) -> FileCamera:
    name = str(value.get("model", "none")).rpartition(".")[2].lower()
    coefficients = [float(k) for k in value.get("coeffs", ())]
    if name not in REALSENSE_MODELS and any(coefficients):
        choices = ", ".join(REALSENSE_MODELS)
        raise ValueError(f"model {name!r} with distortion cannot be used; choices: {choices}")
    return _with_lens(
        (value["width"], value["height"]),
        (value["fx"], value["fy"]),
        (value["ppx"], value["ppy"]),
        (REALSENSE_MODELS.get(name, ""), coefficients),
        path,
    )


def _bop(value: Mapping[str, Any], path: Path, photo: str) -> CameraFile:
    images = {"": value} if "cam_K" in value else value
    number = "".join(filter(str.isdigit, Path(photo).stem)).lstrip("0") or "0"
    entry: Any = images.get("", images.get(number))
    if entry is None:
        lenses = {tuple(other["cam_K"]) for other in images.values()}
        if len(lenses) > 1:
            raise ValueError(
                f"it has {len(images)} images ({_listed(images)}), none with the number of {photo}"
            )
        entry = {"cam_K": [*lenses.pop()]}
    k = [float(number) for number in entry["cam_K"]]
    camera = _with_lens(None, (k[0], k[4]), (k[2], k[5]), ("", ()), path)
    if "depth_scale" in entry:
        camera = camera.model_copy(update={"depth_scale": float(entry["depth_scale"])})
    world = None
    if "cam_R_w2c" in entry:
        world = _inverse(
            np.reshape(entry["cam_R_w2c"], (3, 3)), np.array(entry["cam_t_w2c"], float) / 1000
        )
    return CameraFile(camera, world)


def _listed(names: Mapping[str, object]) -> str:
    shown = [*names][:_SHOWN]
    return ", ".join(shown) + ", ..." * (len(names) > _SHOWN)


def _inverse(rotation: NDArray, translation: NDArray) -> Rows:
    """Return the rows of the inverse of a rigid transform."""
    result = np.eye(4)
    result[:3, :3] = np.asarray(rotation, float).T
    result[:3, 3] = -result[:3, :3] @ translation
    return rows_of(result)


def _nerfstudio(value: Mapping[str, Any], path: Path, photo: str) -> CameraFile:
    frames = {str(frame["file_path"]): frame for frame in value.get("frames", ())}
    frame = _named(frames, photo, path) if frames else {}
    read = {**value, **frame}
    width, height = read.get("w"), read.get("h")
    if "fl_x" in read:
        focal = (read["fl_x"], read.get("fl_y", read["fl_x"]))
    elif "camera_angle_x" in read and width is not None:
        focal = (width / 2 / np.tan(read["camera_angle_x"] / 2),) * 2
    else:
        raise ValueError("it has no fl_x, and no camera_angle_x with w and h")
    if "cx" in read:
        center = (read["cx"], read["cy"])
    elif width is not None and height is not None:
        center = (width / 2, height / 2)
    else:
        raise ValueError("it has no cx and cy, and no w and h")
    model = "fisheye" if "FISHEYE" in str(read.get("camera_model", "")) else "brown_conrady"
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    coefficients = [float(read.get(name, 0.0)) for name in names]
    size = None if width is None or height is None else (width, height)
    corner = [float(number) - 0.5 for number in center]
    camera = _with_lens(size, focal, corner, (model, coefficients), path)
    world = None
    if "transform_matrix" in read:
        stated = {"pose": read["transform_matrix"], "axes": "opengl"}
        matrix = _checked(stated, path).matrix()
        assert matrix is not None
        world = rows_of(matrix)
    return CameraFile(camera, world)


def _named(images: Mapping[str, Any], photo: str, path: Path) -> Any:
    """Return the image of a file that has the photograph's name, with any folder and suffix."""
    for same in (lambda p: p.name, lambda p: p.stem):
        matches = [image for name, image in images.items() if same(Path(name)) == same(Path(photo))]
        if len(matches) == 1:
            return matches[0]
    if len(images) == 1:
        return next(iter(images.values()))
    raise EvidenceError(
        f"{path} has {len(images)} images ({_listed(images)}), none with the name {photo}: give "
        "the photograph under its name in this file"
    )


def _colmap(folder: Path, photo: str) -> CameraFile:
    file = folder / "cameras.txt"
    if not file.is_file():
        hint = " (export the binary model as text)" if (folder / "cameras.bin").is_file() else ""
        raise EvidenceError(f"{folder} has no cameras.txt{hint}")
    cameras = {row[0]: row for row in _rows(file)}
    images: dict[str, list[str]] = {}
    if (folder / "images.txt").is_file():
        # Every other line lists the points of an image.
        images = {row[9]: row for row in _rows(folder / "images.txt") if _is_image(row)}
    image = _named(images, photo, folder / "images.txt") if images else None
    number = image[8] if image is not None else next(iter(cameras), "")
    if number not in cameras or (image is None and len(cameras) > 1):
        raise EvidenceError(f"{file} has {len(cameras)} cameras, and no image states which to use")
    row = cameras[number]
    if len(row) < 5 or row[1] not in COLMAP_MODELS:
        model = row[1] if len(row) > 1 else ""
        raise EvidenceError(f"{file}: model {model!r}; choices: {', '.join(COLMAP_MODELS)}")
    model, names = COLMAP_MODELS[row[1]]
    try:
        numbers = [float(number) for number in row[4:]]
        values = dict(zip(names.split(), numbers, strict=True))
        size = (int(row[2]), int(row[3]))
        world = None if image is None else _inverse(*_image_pose(image))
    except ValueError:
        raise EvidenceError(f"{file}: camera {number} is not {row[1]} with {names}") from None
    focal = (values.get("f", values.get("fx", 0.0)), values.get("f", values.get("fy", 0.0)))
    coefficients = [v for name, v in values.items() if name[0] in "kp"]
    if row[1] == "RADIAL":
        coefficients = [*coefficients, 0.0, 0.0]
    center = (values["cx"] - 0.5, values["cy"] - 0.5)
    return CameraFile(_with_lens(size, focal, center, (model, coefficients), file), world)


def _rows(file: Path) -> list[list[str]]:
    text = read_untrusted_text(file, EvidenceError, "camera")
    return [line.split() for line in text.splitlines() if line.strip() and line[0] != "#"]


def _is_image(row: Sequence[str]) -> bool:
    """Return True if a row of images.txt is an image: id, quaternion, translation, camera, name."""
    return len(row) == 10 and not row[9].lstrip("-").replace(".", "", 1).isdigit()


def _image_pose(row: Sequence[str]) -> tuple[NDArray, NDArray]:
    from ..spec.pose import matrix

    numbers = np.array([float(number) for number in row[1:8]])
    quat = numbers[:4] / np.linalg.norm(numbers[:4])
    return matrix(quat), numbers[4:]
