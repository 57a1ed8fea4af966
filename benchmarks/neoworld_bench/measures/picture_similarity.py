"""Similarity between a rendered image and the photograph: SSIM, LPIPS, CLIP, DINOv2, Uni3D.

Models are loaded from the user's paths. If the model of a measure is missing, the measure is None,
and `why` contains the reason.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from neoworld_mjx.spec import Spec

from .image_encoders import ImageEncoder, LpipsModel
from .onnx_files import OnnxModel
from .point_clouds import Cloud, Uni3DModel
from .structural_similarity import ssim

PICTURE_MEASURES = ("ssim", "lpips", "clip", "dino", "uni3d")


class PictureMeasure(Spec):
    """Similarity of a rendered image and the photograph."""

    ssim: float | None = None
    """Structural similarity; 1 for equal images."""
    lpips: float | None = None
    """LPIPS distance; 0 for equal images."""
    clip: float | None = None
    """Cosine similarity of CLIP's image features; 1 for equal images."""
    dino: float | None = None
    """Cosine similarity of DINOv2's features (CLS token); 1 for equal images."""
    uni3d: float | None = None
    """Cosine similarity between Uni3D's features of the object's points and of the photograph."""
    why: dict[str, str] = {}
    """Reason of each measure that is None, by name of the measure."""


@dataclass(frozen=True)
class PictureModels:
    """Loaded models; a model is None if its path was not given."""

    lpips: LpipsModel | None = None
    clip: ImageEncoder | None = None
    dino: ImageEncoder | None = None
    uni3d: Uni3DModel | None = None

    @staticmethod
    def load(
        *,
        lpips: Path | None = None,
        clip: Path | None = None,
        dino: Path | None = None,
        uni3d: Path | None = None,
    ) -> "PictureModels":
        """Load the models whose paths are given.

        Raises:
            ConfigError: onnxruntime or a file is missing, or a file is not a model of this kind.
        """
        return PictureModels(
            lpips=None if lpips is None else LpipsModel(lpips),
            clip=None if clip is None else ImageEncoder(clip, "clip"),
            dino=None if dino is None else ImageEncoder(dino, "dino"),
            uni3d=None if uni3d is None else Uni3DModel(uni3d),
        )

    def described(self) -> dict[str, dict[str, str] | None]:
        """Return the file and the digest of each model; None for models that were not given."""
        models: dict[str, OnnxModel | None] = {
            "lpips": self.lpips and self.lpips.model,
            "clip": self.clip and self.clip.model,
            "dino": self.dino and self.dino.model,
            "uni3d": self.uni3d and self.uni3d.points,
        }
        return {name: model and model.described() for name, model in models.items()}


def picture_measure(
    photo: UInt8[np.ndarray, "h w 3"],
    rendered: UInt8[np.ndarray, "_ _ 3"],
    models: PictureModels,
    cloud: Cloud | None = None,
) -> PictureMeasure:
    """Compare a rendered image with the photograph.

    Args:
        photo: the photograph or a crop of it.
        rendered: rendered image of the same view and size.
        models: loaded models.
        cloud: points of the object in the images, for Uni3D; None if the images show a scene.

    Raises:
        PhotoError: the images differ in size or are too small.
        ConfigError: a model fails on the images, or its output is not finite.
    """
    clip, dino, lpips, uni3d = models.clip, models.dino, models.lpips, models.uni3d
    values = {
        "ssim": ssim(photo, rendered),
        "lpips": lpips and lpips.distance(photo, rendered),
        "clip": clip and float(clip.embed(photo) @ clip.embed(rendered)),
        "dino": dino and float(dino.embed(photo) @ dino.embed(rendered)),
        "uni3d": uni3d and (None if cloud is None else uni3d.similarity(cloud, photo)),
    }
    why = {name: f"no --{name} PATH" for name, value in values.items() if value is None}
    if cloud is None:
        why["uni3d"] = "measured of objects, not of scenes"
    return PictureMeasure(**values, why=why)
