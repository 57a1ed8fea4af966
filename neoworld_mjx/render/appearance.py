"""Appearance of geoms: color, gloss, pattern and print of their materials."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import body_name, visual_name
from ..spec import SceneSpec, SurfacePattern
from ..spec.finish import Finish, finish
from .prints import ReadPrint, read_print
from .surface_patterns import patterned


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
