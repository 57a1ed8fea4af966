"""Appearance of surfaces: colour, gloss and pattern of each geom by its material."""

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
    """Optical properties per geom of a model."""

    colour: NDArray
    """Linear rgb, [geom, 3]."""
    gloss: NDArray
    """Share of the surroundings that it mirrors when seen head-on, [geom]."""
    metal: NDArray
    """Whether it mirrors in its own colour and scatters little, bool [geom]."""
    patterned: NDArray
    """Whether it has a pattern or a print, bool [geom]."""
    patterns: dict[int, SurfacePattern]
    """Patterns by geom id."""
    prints: dict[int, ReadPrint]
    """Prints of the photograph by geom id, from the origin of the geom's body."""
    to_object: NDArray
    """Rotation of geom to object coordinates at rest, [geom, 3, 3]."""
    offset: NDArray
    """Translation of the same [m], [geom, 3]."""


def appearance_of(
    model: mujoco.MjModel, data: mujoco.MjData, scene: SceneSpec | None = None
) -> Appearance:
    """Look up the appearance of each geom.

    Args:
        model: the model; colours are its own.
        data: its pose, from which patterns take their place on an object.
        scene: what the model was made of; without it materials have no names and all are alike.
    """
    n = model.ngeom
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = model.mat_rgba[model.geom_matid[with_material]]
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
                    made = finish(material)
                    if material.photo is not None:
                        joints = obj.spec.joints
                        at = next((j.pos for j in joints if j.child == part.name), np.zeros(3))
                        prints[g] = read_print(material.photo).shifted(np.array(at))
                    metal[g] = made.metallic >= 0.5
                    if made.pattern is not None:
                        patterns[g] = made.pattern
                    gloss[g] = _gloss(made)
                    owner[g] = body
    # Patterns live in the frame of the geom's own body: a drawer keeps its pattern as it slides.
    turn = data.xmat[owner].reshape(n, 3, 3)
    to_object = np.swapaxes(turn, 1, 2)
    offset = -np.einsum("nij,nj->ni", to_object, data.xpos[owner])
    has_pattern = np.isin(np.arange(n), [*patterns, *prints])
    colour = linear(rgba[:, :3])
    return Appearance(colour, gloss, metal, has_pattern, patterns, prints, to_object, offset)


def _gloss(made: Finish) -> float:
    """Return the share that a surface mirrors; rough ones scatter it instead."""
    if made.metallic >= 0.5:
        return float(np.interp(made.roughness, (0.0, 0.35, 1.0), (0.85, 0.55, 0.1)))
    return float(np.interp(made.roughness, (0.15, 0.5, 0.9), (0.06, 0.04, 0.0)))


def albedo(
    appearance: Appearance, geom: NDArray, point: NDArray, normal: NDArray, pixel: NDArray
) -> NDArray:
    """Return the linear colour [n, 3] of geoms.

    Args:
        appearance: of the model's geoms.
        geom: ids [n].
        point: in the world [n, 3] m.
        normal: there [n, 3].
        pixel: size of a pixel there [n] m.
    """
    colour = appearance.colour[geom]
    for g in np.unique(geom[appearance.patterned[geom]]):
        rows = np.flatnonzero(geom == g)
        turn = appearance.to_object[g]
        if g in appearance.prints:
            shown = appearance.prints[g]
            local = point[rows] @ turn.T + appearance.offset[g]
            at, seen = shown.seen(local, normal[rows] @ turn.T)
            colour[rows[seen]] = linear(shown.colour(at[seen]))
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
    """Turn display (sRGB) colour in [0, 1] into linear light."""
    c = np.asarray(colour, float)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def displayed(light: NDArray) -> NDArray:
    """Turn linear light into display (sRGB) colour in [0, 1]; what is brighter is cut off."""
    x = np.clip(light, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


_STEPS = 8192
_DISPLAY = np.round(255 * displayed(np.linspace(0.0, 1.0, _STEPS))).astype(np.uint8)


def display(light: NDArray) -> NDArray:
    """Turn linear light into display colour, uint8, rolling off softly towards 1 and above."""
    x = np.maximum(light, 0.0)
    knee = 0.7
    over = x - knee
    rolled = knee + (1.0 - knee) * over / (over + (1.0 - knee))
    x = np.where(x > knee, rolled, x)
    return _DISPLAY[np.round(x * (_STEPS - 1)).astype(np.int64)]
