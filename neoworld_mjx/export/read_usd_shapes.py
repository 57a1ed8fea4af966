"""Reads shapes and materials of USD prims."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from ..errors import SpecError
from ..render.appearance import displayed
from ..spec import Box, Capsule, Cylinder, Ellipsoid, Sphere
from ..spec.base_shape import BaseShape
from ..spec.mesh import MAX_VERTICES
from .load_mesh import merged_vertices
from .mechanism import GRAY, LinkShape, Triangles

SECTORS = 32
"""Number of sides of the prism that approximates a cone or an elliptic cylinder."""
_TURNS = {
    "X": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    "Y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "Z": np.eye(3),
}
"""Rotation from the z axis to the axis that a token names, by token."""


@dataclass(frozen=True)
class Look:
    """Appearance and friction of a prim, and the name and density of its material."""

    rgba: tuple[float, float, float, float] = GRAY
    friction: float = 0.5
    name: str = ""
    density: float | None = None
    metallic: float | None = None
    roughness: float | None = None


def shapes_of(prim: Usd.Prim, frame: NDArray, notes: list[str]) -> Iterator[LinkShape]:
    """Yield the shape of a prim if the prim is visible or collides.

    Args:
        prim: a geometric prim.
        frame: transform from the prim's frame, with scale, to the mechanism's frame [m], shape
            [4, 4].
        notes: list to which notes on omissions are appended.

    Raises:
        SpecError: a mesh is broken or too large.
    """
    collides, hull, bounding = _collision(prim)
    image = UsdGeom.Imageable(prim)
    visible = (
        image.ComputePurpose() in ("default", "render", "proxy")
        and image.ComputeVisibility() != UsdGeom.Tokens.invisible
    )
    if not (collides or visible):
        return
    posed = _shape(prim, frame, notes)
    if posed is None:
        return
    shape, place = posed
    if collides and bounding and not isinstance(shape, BaseShape):
        shape, place = _bounding_shape(shape, place, bounding)
    role = "both" if collides and visible else "collision" if collides else "visual"
    look = _look(prim, collides)
    yield LinkShape(
        shape, place, role, look.rgba, look.friction, hull=hull, name=look.name,
        density=look.density, metallic=look.metallic, roughness=look.roughness,
    )  # fmt: skip


def _collision(prim: Usd.Prim) -> tuple[bool, bool, str]:
    """Return whether a prim collides, whether its hull is the collider, and its bounding shape.

    The bounding shape is "boundingCube", "boundingSphere" or, for any other approximation, "".
    """
    holder = prim
    while holder and not holder.HasAPI(UsdPhysics.CollisionAPI):
        # CollisionAPI may be applied to a group above the mesh.
        holder = holder.GetParent()
        if (
            holder
            and (holder.IsA(UsdGeom.Gprim) or holder.HasAPI(UsdPhysics.RigidBodyAPI))
            and not holder.HasAPI(UsdPhysics.CollisionAPI)
        ):
            return False, False, ""
    if not holder or holder.IsPseudoRoot():
        return False, False, ""
    if UsdPhysics.CollisionAPI(holder).GetCollisionEnabledAttr().Get() is False:
        return False, False, ""
    kind = ""
    for stating in (prim, holder):
        if stating.HasAPI(UsdPhysics.MeshCollisionAPI):
            kind = UsdPhysics.MeshCollisionAPI(stating).GetApproximationAttr().Get() or ""
            break
    return True, kind == "convexHull", kind if kind in ("boundingCube", "boundingSphere") else ""


def _shape(
    prim: Usd.Prim, frame: NDArray, notes: list[str]
) -> tuple[BaseShape | Triangles, NDArray] | None:
    if prim.IsA(UsdGeom.Mesh):
        return _mesh(prim, frame)
    place, scale = unscaled(frame, even=True)
    if scale is None or not np.all(scale > 1e-9):
        notes.append(f"{prim.GetPath()} is sheared or flat: skipped")
        return None
    if prim.IsA(UsdGeom.Cube):
        edge = UsdGeom.Cube(prim).GetSizeAttr().Get()
        x, y, z = (float(edge * s) for s in scale)
        return Box(size=(x, y, z)), place
    if prim.IsA(UsdGeom.Sphere):
        radii = UsdGeom.Sphere(prim).GetRadiusAttr().Get() * scale
        if np.ptp(radii) <= 1e-6 * radii.max():
            return Sphere(radius=float(radii.mean())), place
        x, y, z = (float(v) for v in radii)
        return Ellipsoid(radii=(x, y, z)), place
    along = str(getattr(prim.GetAttribute("axis"), "Get", lambda: "Z")() or "Z")
    kinds = (UsdGeom.Cylinder, UsdGeom.Capsule, UsdGeom.Cone)
    kind = next((k for k in kinds if prim.IsA(k)), None)
    if kind is None or along not in _TURNS:
        notes.append(f"{prim.GetPath()} is a {prim.GetTypeName()}, which is not imported")
        return None
    typed = kind(prim)
    radius, height = (float(v.Get()) for v in (typed.GetRadiusAttr(), typed.GetHeightAttr()))
    turn = np.eye(4)
    turn[:3, :3] = _TURNS[along]
    k = "XYZ".index(along)
    across = np.delete(scale, k)
    tall = height * float(scale[k])
    even = np.ptp(across) <= 1e-6 * across.max()
    if kind is UsdGeom.Cylinder and even:
        return Cylinder(radius=radius * float(across[0]), height=tall), place @ turn
    if kind is UsdGeom.Capsule and np.ptp(scale) <= 1e-6 * scale.max():
        return Capsule(radius=radius * float(scale[0]), length=tall), place @ turn
    if kind is UsdGeom.Capsule:
        notes.append(f"{prim.GetPath()} is a capsule that is not round: skipped")
        return None
    return _prism(radius, height, 0.0 if kind is UsdGeom.Cone else radius, turn, scale), place


def _prism(low: float, height: float, high: float, turn: NDArray, scale: NDArray) -> Triangles:
    """Return the triangles of a scaled cone or cylinder whose center is the prim's origin."""
    angle = np.arange(SECTORS) * 2 * np.pi / SECTORS
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = [np.column_stack([r * ring, np.full(SECTORS, z)])
            for r, z in ((low, -height / 2), (max(high, 1e-4 * low), height / 2))]  # fmt: skip
    ends = [[0.0, 0.0, -height / 2], [0.0, 0.0, height / 2]]
    vertices = np.vstack([*rows, ends]) @ turn[:3, :3].T * scale
    faces = []
    for k in range(SECTORS):
        n = (k + 1) % SECTORS
        up, up_n = k + SECTORS, n + SECTORS
        faces += [(k, n, up_n), (k, up_n, up), (2 * SECTORS, n, k), (2 * SECTORS + 1, up, up_n)]
    return vertices, np.array(faces)


def _mesh(prim: Usd.Prim, frame: NDArray) -> tuple[Triangles, NDArray] | None:
    mesh = UsdGeom.Mesh(prim)
    points = mesh.GetPointsAttr().Get()
    counts, index = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
    if not points or not counts or not index:
        return None
    vertices = np.array(points, float)
    faces = _triangles(str(prim.GetPath()), np.array(counts), np.array(index), len(vertices))
    if len(vertices) > MAX_VERTICES:
        raise SpecError(
            f"{prim.GetPath()} has {len(vertices)} vertices; the limit is {MAX_VERTICES}"
        )
    place, scale = unscaled(frame)
    if scale is None:
        place = np.eye(4)
        place[:3, 3] = frame[:3, 3]
        vertices = vertices @ frame[:3, :3].T
    else:
        vertices = vertices * scale
    left = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    if left != (np.linalg.det(frame[:3, :3]) < 0):
        faces = faces[:, ::-1]
    return merged_vertices(vertices, faces), place


def _triangles(name: str, counts: NDArray, index: NDArray, vertices: int) -> NDArray:
    """Split polygons into fans of triangles, shape [f, 3]."""
    if counts.min() < 0 or counts.sum() != len(index):
        raise SpecError(f"{name}: its faces need {counts.sum()} indices, but it has {len(index)}")
    if index.min() < 0 or index.max() >= vertices:
        raise SpecError(f"{name}: a face refers to a missing vertex")
    first = np.cumsum(counts) - counts
    fans = np.repeat(first, np.maximum(counts - 2, 0))
    step = np.concatenate([np.arange(n) for n in np.maximum(counts - 2, 0)] or [np.zeros(0, int)])
    return np.column_stack([index[fans], index[fans + step + 1], index[fans + step + 2]])


def unscaled(frame: NDArray, *, even: bool = False) -> tuple[NDArray, NDArray | None]:
    """Split a transform into a rigid transform, shape [4, 4], and scales along its axes, shape [3].

    The scales are None if the transform is sheared or singular.

    Args:
        frame: the transform, shape [4, 4].
        even: if True, the shape has mirror symmetry, so the transform may mirror. If False, a
            transform that mirrors is treated as sheared.
    """
    linear = frame[:3, :3]
    scale = np.linalg.norm(linear, axis=0)
    rigid = frame.copy()
    if not np.all(scale > 0):
        return rigid, None
    turn = linear / scale
    if np.linalg.det(turn) < 0:
        if not even:
            return rigid, None
        turn[:, 0] *= -1
    if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-5):
        return rigid, None
    rigid[:3, :3] = turn
    return rigid, scale


def _bounding_shape(mesh: Triangles, place: NDArray, kind: str) -> tuple[BaseShape, NDArray]:
    """Return the bounding box or sphere of a mesh, and the pose of this shape."""
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    shift = np.eye(4)
    shift[:3, 3] = (low + high) / 2
    if kind == "boundingSphere":
        radius = float(np.linalg.norm(mesh[0] - shift[:3, 3], axis=1).max())
        return Sphere(radius=radius), place @ shift
    x, y, z = (float(max(v, 1e-6)) for v in high - low)
    return Box(size=(x, y, z)), place @ shift


def _look(prim: Usd.Prim, collides: bool) -> Look:
    binding = UsdShade.MaterialBindingAPI(prim)
    visual = binding.ComputeBoundMaterial()[0]
    physical = binding.ComputeBoundMaterial("physics")[0] if collides else None
    rgba = _bound_color(visual) or _own_color(prim)
    holder = physical or visual
    friction, density = 0.5, None
    if holder and holder.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        physics = UsdPhysics.MaterialAPI(holder.GetPrim())
        stated = physics.GetDynamicFrictionAttr()
        # The shortest decimal that gives the same single-precision number.
        friction = float(f"{stated.Get():.7g}") if stated.HasAuthoredValue() else 0.5
        density = float(physics.GetDensityAttr().Get() or 0.0) or None
    name = holder.GetPrim().GetName() if holder else ""
    metallic, roughness = (_stated(visual or physical, key) for key in ("metallic", "roughness"))
    return Look(rgba, friction, name, density, metallic, roughness)


def _stated(material: UsdShade.Material | None, name: str) -> float | None:
    """Return a numeric input of a material's surface; None if it is missing or connected."""
    surface = material.ComputeSurfaceSource()[0] if material else None
    stated = surface.GetInput(name) if surface else None
    value = stated.Get() if stated and not stated.HasConnectedSource() else None
    return float(value) if isinstance(value, float | int) and math.isfinite(value) else None


def _own_color(prim: Usd.Prim) -> tuple[float, float, float, float]:
    colors = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get()
    opacities = UsdGeom.Gprim(prim).GetDisplayOpacityAttr().Get()
    if not colors:
        return GRAY
    return _displayed(colors[0], float(opacities[0]) if opacities else 1.0)


def _bound_color(material: UsdShade.Material | None) -> tuple[float, float, float, float] | None:
    """Return the display color of a material's surface; None if it is missing or connected."""
    if not material:
        return None
    surface = material.ComputeSurfaceSource()[0] or material.ComputeSurfaceSource(["mdl"])[0]
    if not surface:
        return None
    for name in ("diffuseColor", "diffuse_color_constant"):
        stated = surface.GetInput(name)
        if stated and not stated.HasConnectedSource() and stated.Get() is not None:
            opacity = surface.GetInput("opacity")
            alpha = opacity.Get() if opacity and not opacity.HasConnectedSource() else 1.0
            return _displayed(stated.Get(), float(1.0 if alpha is None else alpha))
    return None


def _displayed(linear: object, alpha: float) -> tuple[float, float, float, float]:
    """Convert a linear color to a display color with alpha."""
    color = displayed(np.array(list(linear), float))  # pyright: ignore[reportArgumentType]
    red, green, blue = (round(float(v), 5) for v in color)
    return red, green, blue, min(max(alpha, 0.0), 1.0)
