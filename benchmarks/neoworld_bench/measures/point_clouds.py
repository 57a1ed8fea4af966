"""Uni3D: similarity of an object's colored points and an image.

The point encoder, the image tower and its preprocessing are in one folder, as `points.onnx`,
`image.onnx` and `preprocessor_config.json`. This module groups the points for the encoder as
Uni3D's code does: centers are chosen by farthest point sampling, and a group consists of the points
nearest to its center.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import KDTree

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.spec import ObjectSpec, link_poses

from .image_encoders import ImageEncoder
from .onnx_files import OnnxModel, unit
from .surface_measure import SAMPLES, samples_of_each

GROUPS, GROUP_SIZE = 512, 64
"""Number of groups and number of points per group in the published evaluation. They are used if the
ONNX file does not fix them."""

Cloud = Float[np.ndarray, "n 6"]
"""Positions [m], with +z up, and colors (RGB, 0 to 1) of points."""


class Uni3DModel:
    """Uni3D in two ONNX files.

    Args:
        folder: folder with points.onnx, image.onnx and preprocessor_config.json.

    Raises:
        ConfigError: a file is missing or has other inputs.
    """

    def __init__(self, folder: Path) -> None:
        if not (folder / "points.onnx").is_file():
            raise ConfigError(
                f"uni3d: {folder} holds no points.onnx; expected is a folder with points.onnx, "
                "image.onnx and preprocessor_config.json"
            )
        self.points = OnnxModel(folder / "points.onnx", "uni3d")
        advice = "expected is Uni3D's point encoder behind its grouping: center [1, groups, 3] and "
        advice += "features [1, groups, points, 6]"
        shapes = {"center": (1, None, 3), "features": (1, None, None, 6)}
        self.points.check_inputs(shapes, advice)
        features = next(port for port in self.points.inputs if port.name == "features")
        self._groups = features.shape[1] or GROUPS
        self._group_size = features.shape[2] or GROUP_SIZE
        self.image = ImageEncoder(folder, "uni3d")

    def similarity(self, cloud: Cloud, rgb: UInt8[np.ndarray, "h w 3"]) -> float:
        """Return the cosine similarity between the features of an object's points and of an image.

        Raises:
            ConfigError: an output is not finite, or the vectors of features differ in length.
        """
        a, b = self.embed(cloud), self.image.embed(rgb)
        if a.shape != b.shape:
            raise ConfigError(
                f"uni3d: points.onnx gives {len(a)} numbers and image.onnx {len(b)}; expected is "
                "the picture's tower that the point encoder was trained with"
            )
        return float(a @ b)

    def embed(self, cloud: Cloud) -> Float[np.ndarray, " d"]:
        """Return the normalized features of points."""
        center, features = grouped(cloud, self._groups, self._group_size)
        feed = {"center": center[None], "features": features[None]}
        return unit(self.points.run(feed, self.points.outputs[0]).reshape(-1), self.points)


def coloured_points(
    spec: ObjectSpec,
    joint_state: Mapping[str, float] | None = None,
    *,
    count: int = SAMPLES,
    seed: int = 0,
) -> Cloud:
    """Sample the visible shapes of an object uniformly by area, with the colors of the materials.

    If an object has no visible shapes, its colliders are sampled. Patterns and projected
    photographs of materials are ignored.

    Args:
        spec: the object.
        joint_state: values of joints [rad or m]; all other joints are at 0.
        count: number of points.
        seed: seed of the points.
    """
    import trimesh

    poses = link_poses(spec, dict(joint_state or {}))
    geoms = [(part, geom) for part in spec.parts for geom in part.geoms]
    visible = [(part, geom) for part, geom in geoms if geom.role != "collision"] or geoms
    meshes, colors = [], []
    for part, geom in visible:
        vertices, faces = geom.shape.surface()
        vertices = poses[part.name].then(geom.pose()).apply(vertices)
        meshes.append(trimesh.Trimesh(vertices, faces, process=False))
        colors.append(spec.material(geom.material).rgba[:3])
    points = samples_of_each(meshes, count, seed)
    rgb = np.repeat(np.array(colors), [len(each) for each in points], axis=0)
    return np.column_stack([np.vstack(points), rgb])


def grouped(
    cloud: Cloud, groups: int, group_size: int
) -> tuple[Float[np.ndarray, "g 3"], Float[np.ndarray, "g m 6"]]:
    """Group points for Uni3D's encoder.

    Points are centered and divided by the largest distance from the center, and y and z are
    swapped, as in Uni3D's evaluation.

    Args:
        cloud: points and colors; at least `groups` and at least `group_size` points.
        groups: number of groups.
        group_size: number of points of a group.

    Returns:
        Centers of the groups [g, 3], and for each group the positions relative to its center and
        the colors of its points [g, m, 6].
    """
    xyz = cloud[:, [0, 2, 1]] - cloud[:, [0, 2, 1]].mean(axis=0)
    xyz = xyz / max(float(np.linalg.norm(xyz, axis=1).max()), 1e-6)
    center = xyz[farthest_points(xyz, groups)]
    _, nearest = KDTree(xyz).query(center, group_size)
    nearest = np.asarray(nearest).reshape(groups, group_size)
    features = np.concatenate([xyz[nearest] - center[:, None], cloud[nearest, 3:]], axis=-1)
    return center, features


def farthest_points(xyz: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " count"]:
    """Return the indices of points chosen by farthest point sampling, starting with point 0."""
    chosen = np.zeros(count, int)
    distance = np.full(len(xyz), np.inf)
    for k in range(1, count):
        offset = xyz - xyz[chosen[k - 1]]
        distance = np.minimum(distance, np.einsum("ij,ij->i", offset, offset))
        chosen[k] = int(np.argmax(distance))
    return chosen
