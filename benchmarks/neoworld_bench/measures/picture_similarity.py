"""Similarity between a rendered image and the photograph: SSIM, LPIPS, CLIP, DINOv2, Uni3D.

SSIM (Wang et al. 2004) needs no model. The others are ONNX files of the user, run by onnxruntime
(extra `metrics`) on the CPU:

    clip, dino    a folder with model.onnx (image tower) and preprocessor_config.json
    lpips         a file with two image inputs [1, 3, h, w] in [-1, 1]
    uni3d         a folder with points.onnx, and model.onnx and preprocessor_config.json of its
                  image tower
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from pydantic import BaseModel, ConfigDict
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from neoworld_mjx.errors import ConfigError, PhotoError
from neoworld_mjx.io import read_model
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.spec import ObjectSpec, link_poses

from .surface_measure import SAMPLES, samples_of_each

MEASURES = ("ssim", "lpips", "clip", "dino", "uni3d")
CONFIG = "preprocessor_config.json"
SIGMA, RADIUS, C1, C2 = 1.5, 5, (255 * 0.01) ** 2, (255 * 0.03) ** 2
"""Gaussian window of SSIM [px], and constants of equation 13 in Wang et al."""
GROUPS, GROUP_SIZE = 512, 64
"""Groups of points, and points of a group, in Uni3D's published evaluation."""

Rgb = UInt8[np.ndarray, "h w 3"]
Cloud = Float[np.ndarray, "n 6"]
"""Positions [m], with +z up, and colors (RGB, 0 to 1) of points."""
Vector = Float[np.ndarray, " d"]


class OnnxModel:
    """Model of an ONNX file.

    Args:
        path: the file.

    Raises:
        ConfigError: onnxruntime is not installed, or the file is not a model.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise ConfigError(
                f"{path}: onnxruntime is not installed: uv sync --inexact --extra metrics"
            ) from None
        self.path = path
        try:
            self.sha256 = content_hash(path)[:16]
            providers = ["CPUExecutionProvider"]
            self._session = onnxruntime.InferenceSession(str(path), providers=providers)
        except Exception as error:  # onnxruntime's exceptions have no common base class.
            raise ConfigError(f"{path} is no ONNX model: {str(error)[:300]}") from None
        self.inputs = [port.name for port in self._session.get_inputs()]

    def run(self, values: Mapping[str, np.ndarray], output: str | None = None) -> np.ndarray:
        """Return an output, by default the first, as float64.

        Raises:
            ConfigError: the model takes other inputs, or its output is not finite.
        """
        feed = {name: value.astype(np.float32) for name, value in values.items()}
        try:
            result = np.asarray(self._session.run(output and [output], feed)[0], float)
        except Exception as error:
            raise ConfigError(
                f"{self.path} takes {', '.join(self.inputs)} and fails: {str(error)[:300]}"
            ) from None
        if not np.isfinite(result).all():
            raise ConfigError(f"{self.path} gives numbers that are not finite")
        return result


class Preprocessing(BaseModel):
    """The file `preprocessor_config.json`, as `transformers` writes it for CLIP and DINOv2."""

    model_config = ConfigDict(extra="ignore")

    size: int | dict[str, int]
    """Length of the shorter side after resizing [px]."""
    crop_size: int | dict[str, int]
    """Side length of the center crop [px]."""
    resample: int = 3
    """Pillow's number of the resampling filter; 3 is bicubic."""
    image_mean: tuple[float, float, float]
    image_std: tuple[float, float, float]

    def tensor(self, rgb: Rgb) -> Float[np.ndarray, "1 3 side side"]:
        """Preprocess an image into the model's input."""
        short, side = (
            next(iter(value.values())) if isinstance(value, dict) else value
            for value in (self.size, self.crop_size)
        )
        height, width = rgb.shape[:2]
        # Round the longer side down, as the published preprocessors do.
        scale = short / min(width, height)
        image = Image.fromarray(rgb).resize(
            (int(width * scale), int(height * scale)), Image.Resampling(self.resample)
        )
        left, top = (image.width - side) // 2, (image.height - side) // 2
        cut = np.asarray(image.crop((left, top, left + side, top + side)), np.float32) / 255
        values = (cut - np.array(self.image_mean)) / np.array(self.image_std)
        return values.transpose(2, 0, 1)[None]


class ImageEncoder:
    """Image tower with its preprocessing.

    Args:
        folder: with model.onnx and preprocessor_config.json.

    Raises:
        ConfigError: a file is missing or is not of this kind.
    """

    def __init__(self, folder: Path) -> None:
        self.preprocessing = read_model(folder / CONFIG, Preprocessing, ConfigError, "a config")
        self.model = OnnxModel(folder / "model.onnx")

    def embed(self, rgb: Rgb) -> Vector:
        """Return the normalized features of an image; of tokens, those of the first (CLS)."""
        values = self.model.run({"pixel_values": self.preprocessing.tensor(rgb)})
        return _unit(values[0, 0] if values.ndim == 3 else values[0])


class Uni3DModel:
    """Uni3D: an encoder of colored points, and the image tower that it was trained with.

    Args:
        folder: with points.onnx, model.onnx and preprocessor_config.json.

    Raises:
        ConfigError: a file is missing or is not of this kind.
    """

    def __init__(self, folder: Path) -> None:
        self.model, self.image = OnnxModel(folder / "points.onnx"), ImageEncoder(folder)

    def similarity(self, cloud: Cloud, rgb: Rgb) -> float:
        """Return the cosine similarity between the features of an object's points and an image."""
        center, features = grouped(cloud, GROUPS, GROUP_SIZE)
        points = self.model.run({"center": center[None], "features": features[None]})
        return float(_unit(points.reshape(-1)) @ self.image.embed(rgb))


class PictureModels:
    """Models of the measures, from their paths; a measure without a path is None.

    Raises:
        ConfigError: onnxruntime or a file is missing, or a file is not a model.
    """

    def __init__(
        self,
        *,
        lpips: Path | None = None,
        clip: Path | None = None,
        dino: Path | None = None,
        uni3d: Path | None = None,
    ) -> None:
        self.lpips = None if lpips is None else OnnxModel(lpips)
        self.clip = None if clip is None else ImageEncoder(clip)
        self.dino = None if dino is None else ImageEncoder(dino)
        self.uni3d = None if uni3d is None else Uni3DModel(uni3d)

    def described(self) -> dict[str, Any]:
        """Return the file and the digest of each model."""
        models = {
            "lpips": self.lpips,
            "clip": self.clip and self.clip.model,
            "dino": self.dino and self.dino.model,
            "uni3d": self.uni3d and self.uni3d.model,
        }
        return {
            name: {"file": str(model.path), "sha256": model.sha256}
            for name, model in models.items()
            if model is not None
        }

    def compare(
        self, photo: Rgb, rendered: UInt8[np.ndarray, "_ _ 3"], cloud: Cloud | None = None
    ) -> dict[str, float | None]:
        """Compare a rendered image with the photograph, by MEASURES; None without a model.

        Args:
            photo: the photograph or a crop of it.
            rendered: rendered image of the same view and size.
            cloud: points of the object in the images, for Uni3D; None if they show a scene.

        Raises:
            PhotoError: the images differ in size or are too small.
            ConfigError: a model fails on the images.
        """
        cosine = lambda encoder: float(encoder.embed(photo) @ encoder.embed(rendered))
        return {
            "ssim": ssim(photo, rendered),
            "lpips": None if self.lpips is None else _lpips(self.lpips, photo, rendered),
            "clip": None if self.clip is None else cosine(self.clip),
            "dino": None if self.dino is None else cosine(self.dino),
            "uni3d": None
            if self.uni3d is None or cloud is None
            else self.uni3d.similarity(cloud, photo),
        }


def _lpips(model: OnnxModel, a: Rgb, b: UInt8[np.ndarray, "_ _ 3"]) -> float:
    pictures = [(rgb / 127.5 - 1).transpose(2, 0, 1)[None] for rgb in (a, b)]
    return float(model.run(dict(zip(model.inputs, pictures, strict=True))).reshape(()))


def _unit(vector: np.ndarray) -> Vector:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def ssim(a: Rgb, b: UInt8[np.ndarray, "_ _ 3"]) -> float:
    """Return the mean SSIM over pixels and color channels, which is 1 for equal images.

    Only windows of 11 x 11 pixels that lie entirely within the image are used.

    Raises:
        PhotoError: the images differ in size, or a side is under 11 pixels.
    """
    if a.shape != b.shape or min(a.shape[:2]) <= 2 * RADIUS:
        raise PhotoError(
            f"SSIM compares pictures of one size with sides of at least {2 * RADIUS + 1} pixels, "
            f"got {a.shape[1]} x {a.shape[0]} and {b.shape[1]} x {b.shape[0]}"
        )
    x, y = a.astype(float), b.astype(float)
    mean_x, mean_y = _blurred(x), _blurred(y)
    variances = _blurred(x * x) - mean_x**2 + _blurred(y * y) - mean_y**2
    covariance = _blurred(x * y) - mean_x * mean_y
    structure = (2 * covariance + C2) / (variances + C2)
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return float((luminance * structure)[RADIUS:-RADIUS, RADIUS:-RADIUS].mean())


def _blurred(values: np.ndarray) -> np.ndarray:
    return gaussian_filter(values, (SIGMA, SIGMA, 0.0), radius=(RADIUS, RADIUS, 0))


def colored_points(
    spec: ObjectSpec, joint_state: Mapping[str, float], count: int = SAMPLES
) -> Cloud:
    """Sample the visible shapes of an object uniformly by area, with the colors of the materials.

    Args:
        spec: the object.
        joint_state: values of joints [rad or m]; all other joints are at 0.
        count: number of points.
    """
    import trimesh

    poses = link_poses(spec, dict(joint_state))
    meshes, colors = [], []
    for part in spec.parts:
        for geom in part.geoms:
            if geom.role == "collision":
                continue
            vertices, faces = geom.shape.surface()
            vertices = poses[part.name].then(geom.pose()).apply(vertices)
            meshes.append(trimesh.Trimesh(vertices, faces, process=False))
            colors.append(spec.material(geom.material).rgba[:3])
    points = samples_of_each(meshes, count, 0)
    rgb = np.repeat(np.array(colors), [len(each) for each in points], axis=0)
    return np.column_stack([np.vstack(points), rgb])


def grouped(
    cloud: Cloud, groups: int, group_size: int
) -> tuple[Float[np.ndarray, "g 3"], Float[np.ndarray, "g m 6"]]:
    """Group points for Uni3D's encoder, as Uni3D's evaluation does.

    Points are centered and divided by the largest distance from the center, and y and z are
    swapped. Centers of groups are chosen by farthest point sampling.

    Returns:
        Centers of the groups, and for each group the positions relative to its center and the
        colors of the `group_size` points nearest to it.
    """
    xyz = cloud[:, [0, 2, 1]] - cloud[:, [0, 2, 1]].mean(axis=0)
    xyz = xyz / max(float(np.linalg.norm(xyz, axis=1).max()), 1e-6)
    chosen, distance = [0], np.full(len(xyz), np.inf)
    while len(chosen) < groups:
        distance = np.minimum(distance, ((xyz - xyz[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    center = xyz[chosen]
    nearest = np.asarray(KDTree(xyz).query(center, group_size)[1]).reshape(groups, group_size)
    return center, np.concatenate([xyz[nearest] - center[:, None], cloud[nearest, 3:]], axis=-1)
