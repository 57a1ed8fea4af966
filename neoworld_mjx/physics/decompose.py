"""Convex decomposition of imported meshes, by CoACD where it is installed, cached by content."""

import hashlib
import importlib.util
import logging
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cache import cache_folder
from ..errors import RunError
from ..io import read_arrays
from ..io.files import write_atomic

_log = logging.getLogger(__name__)
CLOSED, OPEN = (0.02, 96), (0.08, 16)
"""Remaining concavity over the mesh's size, and most pieces: of closed meshes, and of others, which
are wrapped first; finer pieces of those would cost a minute and still be too thick."""
MAX_CORNERS = 48
CACHE_VERSION = "3"
SHEET_M = 0.002
"""Thickness given to flat sheets, which have no volume otherwise."""
CONVEX_SHARE = 0.97
"""Share of its hull's volume above which a mesh counts as convex."""


def installed() -> bool:
    """Tell whether CoACD is there; without it a mesh becomes its convex hull."""
    return importlib.util.find_spec("coacd") is not None


def convex_pieces(vertices: NDArray, faces: NDArray) -> list[NDArray]:
    """Split a mesh into convex pieces, each the points [n, 3] m of a hull.

    A convex mesh is its own piece. Without CoACD, or where it fails, the hull stands for all.

    Args:
        vertices: [v, 3] m.
        faces: triangles [f, 3].
    """
    vertices, faces = np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64)
    whole = [hull_points(vertices)]
    if flat(vertices) or is_convex(vertices, faces) or not installed():
        return whole
    key = hashlib.sha256()
    for value in (f"{CACHE_VERSION}:{CLOSED}:{OPEN}:{MAX_CORNERS}", vertices, faces):
        key.update(value.encode() if isinstance(value, str) else value.tobytes())
    kept = cache_folder() / "coacd" / f"{key.hexdigest()}.npz"
    try:
        stored = [np.asarray(p, float) for p in read_arrays(kept, RunError).values()]
        if stored and all(_is_piece(points) for points in stored):
            return stored
    except (RunError, TypeError, ValueError):
        pass  # It is made again.
    pieces = _coacd(vertices, faces) or whole
    _keep(kept, pieces)
    return pieces


def _is_piece(points: NDArray) -> bool:
    return points.ndim == 2 and points.shape[1] == 3 and bool(np.isfinite(points).all())


def flat(vertices: NDArray) -> bool:
    """Tell whether a mesh is a sheet, which has no inside to be split."""
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)
    return float(np.ptp((vertices - vertices.mean(axis=0)) @ spread[2].T, axis=0).min()) < SHEET_M


def is_convex(vertices: NDArray, faces: NDArray) -> bool:
    """Tell whether a mesh fills its convex hull; one that is not closed is never known to."""
    mesh = _merged(vertices, faces)
    if not mesh.is_watertight:
        return False
    full = volume_of_hull(vertices)
    return full > 0 and abs(float(mesh.volume)) > CONVEX_SHARE * full


def _merged(vertices: NDArray, faces: NDArray) -> Any:
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=True)


def volume_of_hull(vertices: NDArray) -> float:
    """Return the volume [m^3] of the convex hull; 0 for what is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(vertices).volume)
    except (QhullError, ValueError):
        return 0.0


def hull_points(vertices: NDArray) -> NDArray:
    """Return points [n, 3] whose hull is that of a mesh, few and never flat.

    Of a hull with many corners those furthest in evenly spread directions are kept; sheets are
    thickened along their normal.
    """
    points = np.unique(np.round(vertices, 9), axis=0)
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2]
    local = (points - centre) @ axes.T
    thin = np.ptp(local, axis=0) < SHEET_M
    if thin.any():
        shift = np.array(np.meshgrid(*[(-1, 1) if t else (0,) for t in thin])).reshape(3, -1).T
        flat = np.where(thin, 0.0, local)
        # Many points of a sheet are in its inside; its outline is enough.
        flat = flat[_furthest(flat)]
        local = (flat[:, None] + shift[None] * SHEET_M / 2).reshape(-1, 3)
        return np.unique(local @ axes + centre, axis=0)
    return points[_furthest(points)]


def _furthest(points: NDArray) -> NDArray:
    if len(points) <= MAX_CORNERS:
        return np.arange(len(points))
    return np.unique((_directions() @ (points - points.mean(axis=0)).T).argmax(axis=1))


@lru_cache(maxsize=1)
def _directions() -> NDArray:
    """Return unit vectors spread evenly, those of a box's faces and corners among them [n, 3]."""
    k = np.arange(120) + 0.5
    z = 1 - 2 * k / 120
    angle = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    spread = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    box = np.array([[x, y, w] for x in (-1, 0, 1) for y in (-1, 0, 1) for w in (-1, 0, 1)], float)
    box = box[np.abs(box).sum(axis=1) > 0]
    return np.vstack([spread, box / np.linalg.norm(box, axis=1, keepdims=True)])


def _coacd(vertices: NDArray, faces: NDArray) -> list[NDArray]:
    import coacd

    coacd.set_log_level("error")
    mesh = _merged(vertices, faces)
    # Wrapping makes walls thicker by a fiftieth of the size: what is closed needs none.
    closed = bool(mesh.is_watertight)
    concavity, most = CLOSED if closed else OPEN
    try:
        parts = coacd.run_coacd(
            coacd.Mesh(mesh.vertices, mesh.faces) if closed else coacd.Mesh(vertices, faces),
            threshold=concavity,
            max_convex_hull=most,
            preprocess_mode="off" if closed else "auto",
            preprocess_resolution=50,
            mcts_iterations=20,
            mcts_nodes=10,
            mcts_max_depth=2,
            resolution=1000,
            decimate=True,
            max_ch_vertex=MAX_CORNERS,
        )
    except Exception as error:  # a library's border: the hull is there in any case
        _log.warning("CoACD failed (%s); the convex hull stands for the mesh", error)
        return []
    # What is not closed is wrapped first, which blows it up; what sticks out of it is cut off.
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return [
        hull_points(np.clip(np.asarray(points, float), low, high))
        for points, _ in parts
        if len(points) >= 4
    ]


def _keep(path: Path, pieces: list[NDArray]) -> None:
    import io

    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, allow_pickle=False, **{f"p{k:03d}": p for k, p in enumerate(pieces)}
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, buffer.getvalue())
    except OSError:
        pass  # The next run decomposes it again.
