"""Appearance of geoms: color, gloss, pattern, and print of the photograph on their materials."""

import base64
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image

from ..errors import SpecError
from ..io.binary_files import open_image
from ..physics.mjcf import body_name, visual_name
from ..spec import Material, SceneSpec, SurfacePattern
from ..spec.finish import Finish, finish
from ..spec.room import PhotoPrint
from .surface_patterns import patterned

LEAST_COSINE = 0.2
"""Smallest cosine between the normal at a printed point and the direction towards the camera."""
DEPTH_SHARE = 0.015
"""Largest difference between the depth of a visible point and the depth stored in the print,
relative to the depth of the point."""
MOST_CONDITION = 1e9
"""Largest condition number of the matrix of a print. Real cameras have far smaller ones."""
STRIP = 8
"""Number of rows in the strip of plain color below the image of a print."""


@dataclass(frozen=True)
class ReadPrint:
    """A print with decoded images."""

    colours: NDArray
    """Display (sRGB) colors, uint8 [h, w, 3]."""
    depths: NDArray
    """Depths [m], shape [h, w]; inf where the object was not visible."""
    turn: NDArray
    """Linear part of the projection [1/m], shape [3, 3]."""
    shift: NDArray
    """Translation of the projection, shape [3]."""

    def shifted(self, origin: NDArray) -> "ReadPrint":
        """Return the print for points that are given relative to another origin [m], shape [3]."""
        shift = self.shift + self.turn @ origin
        return ReadPrint(self.colours, self.depths, self.turn, shift)

    def project(self, points: NDArray, normals: NDArray) -> tuple[NDArray, NDArray]:
        """Project points into the window of the print, and test which points the print shows.

        Args:
            points: points in the object's frame [m], shape [n, 3].
            normals: normals at the points, of any length, shape [n, 3].

        Returns:
            Positions (u, v) in the window, shape [n, 2], and a mask of the visible points, [n].
        """
        local = points @ self.turn.T + self.shift
        depth = np.where(local[:, 2] > 1e-9, local[:, 2], 1e-9)
        position = local[:, :2] / depth[:, None]
        eye = np.linalg.solve(self.turn, -self.shift)
        away = eye - points
        sizes = np.linalg.norm(away, axis=1) * np.linalg.norm(normals, axis=1)
        facing = np.sum(away * normals, axis=1) > LEAST_COSINE * sizes
        inside = np.all((position >= 0) & (position < 1), axis=1) & (local[:, 2] > 1e-9)
        h, w = self.depths.shape
        row = np.clip((position[:, 1] * h).astype(int), 0, h - 1)
        column = np.clip((position[:, 0] * w).astype(int), 0, w - 1)
        near = np.abs(self.depths[row, column] - depth) < DEPTH_SHARE * depth
        return position, facing & inside & near

    def colour(self, position: NDArray) -> NDArray:
        """Return display colors [n, 3] in [0, 1] at positions (u, v) [n, 2] in the window."""
        h, w = self.colours.shape[:2]
        x, y = (
            np.clip(position[:, 0] * w - 0.5, 0, w - 1),
            np.clip(position[:, 1] * h - 0.5, 0, h - 1),
        )
        left, top = x.astype(int), y.astype(int)
        right, low = np.minimum(left + 1, w - 1), np.minimum(top + 1, h - 1)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        c = self.colours / 255.0
        upper = c[top, left] * (1 - fx) + c[top, right] * fx
        lower = c[low, left] * (1 - fx) + c[low, right] * fx
        return upper * (1 - fy) + lower * fy

    def texture_coordinates(self, position: NDArray, visible: NDArray) -> NDArray:
        """Return texture coordinates on the image of `print_png`, shape [n, 2]; v points upwards.

        Points that the camera does not see map to the strip of plain color at the lower edge.
        """
        rows = self.colours.shape[0]
        share = rows / (rows + STRIP)
        u = np.where(visible, np.clip(position[:, 0], 0, 1), 0.5)
        v = np.where(visible, 1 - np.clip(position[:, 1], 0, 1) * share, (1 - share) / 2)
        return np.round(np.stack([u, v], axis=1), 6)


def read_print(photo: PhotoPrint) -> ReadPrint:
    """Decode a print; recent results are cached.

    Raises:
        SpecError: the images of the print cannot be read, or its matrix is singular.
    """
    return _read_print(photo)  # pyright: ignore[reportArgumentType] frozen models are hashable


@lru_cache(maxsize=64)
def _read_print(photo: PhotoPrint) -> ReadPrint:
    if np.linalg.cond(np.array(photo.turn)) > MOST_CONDITION:
        raise SpecError("the matrix of a print is singular: its rows are not independent")
    colours = _decoded(photo.image, "RGB")
    levels = _decoded(photo.depth, "I;16").astype(float)
    depths = photo.near + (levels - 1) / 65534 * (photo.far - photo.near)
    depths = np.where(levels > 0, depths, np.inf)
    return ReadPrint(colours, depths, np.array(photo.turn), np.array(photo.shift))


def _decoded(text: str, mode: str) -> NDArray:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        raise SpecError("the image of a print is not base64") from None
    with open_image(data, "the image of a print", SpecError, ("PNG",)) as image:
        if mode == "RGB":
            return np.asarray(image.convert("RGB"))
        if image.mode not in ("I;16", "I"):
            raise SpecError(f"the depths of a print have mode {image.mode}, not 16 bits")
        return np.asarray(image)


def base64_png(image: NDArray) -> str:
    """Return an image, uint8 [h, w, 3] or uint16 [h, w], as PNG in base64."""
    return base64.b64encode(_png(image)).decode()


def _png(image: NDArray) -> bytes:
    # The search for the smallest file takes five times as long and saves 4 %.
    content = BytesIO()
    Image.fromarray(image).save(content, format="PNG")
    return content.getvalue()


def print_png(material: Material) -> bytes:
    """Return the texture of a printed material as PNG: the print above a strip of plain color.

    Recent results are cached, because the encoding dominates the time of an export.
    """
    assert material.photo is not None
    photo: Any = material.photo  # Frozen models are hashable.
    return _print_png(photo, material.rgba[:3])


@lru_cache(maxsize=64)
def _print_png(photo: PhotoPrint, rgb: tuple[float, float, float]) -> bytes:
    colours = read_print(photo).colours
    plain = np.round(255 * np.array(rgb)).astype(np.uint8)
    strip = np.broadcast_to(plain, (STRIP, colours.shape[1], 3))
    return _png(np.concatenate([colours, strip]))


@dataclass(frozen=True)
class Appearance:
    """Optical properties of each geom of a model."""

    colour: NDArray
    """Linear RGB color, shape [geom, 3]."""
    gloss: NDArray
    """Reflectance at normal incidence, shape [geom]."""
    metal: NDArray
    """True if reflections have the color of the geom, bool [geom]."""
    patterned: NDArray
    """True if the geom has a pattern or a print, bool [geom]."""
    patterns: dict[int, SurfacePattern]
    """Patterns by geom id."""
    prints: dict[int, ReadPrint]
    """Prints of the photograph by geom id, in the frame of the geom's body."""
    photographed: NDArray
    """True if the color comes from the photograph (the geom has a print), bool [geom]."""
    to_object: NDArray
    """Rotation from the world frame to the frame of each geom's body, shape [geom, 3, 3]."""
    offset: NDArray
    """Translation from the world frame to the frame of each geom's body [m], shape [geom, 3]."""


def appearance_of(
    model: mujoco.MjModel, data: mujoco.MjData, scene: SceneSpec | None = None
) -> Appearance:
    """Return the appearance of every geom.

    Args:
        model: the model, which defines the colors.
        data: data of the model after `mj_kinematics`, which defines the frames of patterns.
        scene: the scene of the model, which defines gloss, patterns and prints. If None, all geoms
            have the same gloss and no pattern.
    """
    n = model.ngeom
    gloss, metal = np.full(n, 0.04), np.zeros(n, bool)
    patterns: dict[int, SurfacePattern] = {}
    prints: dict[int, ReadPrint] = {}
    owner = model.geom_bodyid.copy()
    if scene is not None:
        for obj in scene.objects:
            for part in obj.spec.parts:
                body = model.body(body_name(obj, part.name)).id
                for geom in part.geoms:
                    name = visual_name(obj.name, geom)
                    g = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
                    if g < 0:
                        continue
                    material = obj.spec.material(geom.material)
                    surface = finish(material)
                    if material.photo is not None:
                        joints = obj.spec.joints
                        origin = next((j.pos for j in joints if j.child == part.name), (0, 0, 0))
                        prints[g] = read_print(material.photo).shifted(np.array(origin, float))
                    metal[g] = surface.metallic >= 0.5
                    if surface.pattern is not None:
                        patterns[g] = surface.pattern
                    gloss[g] = _gloss(surface)
                    owner[g] = body
    # Patterns are functions of points in the frame of the body, so patterns move with the body.
    turn = data.xmat[owner].reshape(n, 3, 3)
    to_object = np.swapaxes(turn, 1, 2)
    offset = -np.einsum("nij,nj->ni", to_object, data.xpos[owner])
    has_pattern = np.isin(np.arange(n), [*patterns, *prints])
    colour = linear(geom_rgba(model)[:, :3])
    from_photo = np.isin(np.arange(n), [*prints])
    return Appearance(
        colour, gloss, metal, has_pattern, patterns, prints, from_photo, to_object, offset
    )


def geom_rgba(model: mujoco.MjModel) -> NDArray:
    """Return the RGBA color of each geom [geom, 4], from its material if it has one."""
    material = model.geom_matid[:, None]
    if not model.nmat:
        return model.geom_rgba.copy()
    return np.where(material >= 0, model.mat_rgba[np.maximum(model.geom_matid, 0)], model.geom_rgba)


def _gloss(surface: Finish) -> float:
    """Return the reflectance of a surface, which decreases with its roughness."""
    if surface.metallic >= 0.5:
        return float(np.interp(surface.roughness, (0.0, 0.35, 1.0), (0.85, 0.55, 0.1)))
    return float(np.interp(surface.roughness, (0.15, 0.5, 0.9), (0.06, 0.04, 0.0)))


def albedo(
    appearance: Appearance, geom: NDArray, point: NDArray, normal: NDArray, pixel: NDArray
) -> NDArray:
    """Return the linear color [n, 3] of points on geoms.

    Args:
        appearance: appearance of the geoms.
        geom: geom ids [n].
        point: points in the world frame [m], shape [n, 3].
        normal: normals at the points in the world frame, shape [n, 3].
        pixel: size of a pixel at each point [m], shape [n].
    """
    colour = appearance.colour[geom]
    for g in np.unique(geom[appearance.patterned[geom]]):
        rows = np.flatnonzero(geom == g)
        turn = appearance.to_object[g]
        if g in appearance.prints:
            photo = appearance.prints[g]
            local = point[rows] @ turn.T + appearance.offset[g]
            position, visible = photo.project(local, normal[rows] @ turn.T)
            colour[rows[visible]] = linear(photo.colour(position[visible]))
            continue
        pattern = appearance.patterns[g]
        second = None if pattern.rgb is None else linear(np.array(pattern.rgb))
        colour[rows] = patterned(
            pattern,
            appearance.colour[g],
            second,
            point[rows] @ turn.T + appearance.offset[g],
            normal[rows] @ turn.T,
            pixel[rows],
        )
    return colour


def linear(colour: NDArray) -> NDArray:
    """Convert display (sRGB) color in [0, 1] to linear light."""
    c = np.asarray(colour, float)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def displayed(light: NDArray) -> NDArray:
    """Convert linear light to display (sRGB) color, clipped to [0, 1]."""
    x = np.clip(light, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
) / np.array([[0.9505], [1.0], [1.089]])


def to_lab(rgb: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """Convert display colors (sRGB, 0 to 255) to CIE Lab, D65."""
    xyz = linear(rgb.astype(float) / 255.0) @ _TO_XYZ.T
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack(
        [
            116 * f[..., 1] - 16,
            500 * (f[..., 0] - f[..., 1]),
            200 * (f[..., 1] - f[..., 2]),
        ],
        axis=-1,
    )


_STEPS = 8192
_DISPLAY = np.round(255 * displayed(np.linspace(0.0, 1.0, _STEPS))).astype(np.uint8)


def display(light: NDArray) -> NDArray:
    """Convert linear light to display color (sRGB, uint8); light above 0.85 saturates smoothly."""
    x = np.maximum(light, 0.0)
    knee = 0.85
    over = x - knee
    rolled = knee + (1.0 - knee) * over / (over + (1.0 - knee))
    x = np.where(x > knee, rolled, x)
    return _DISPLAY[np.round(x * (_STEPS - 1)).astype(np.int64)]
