"""Picture of an object that fails its checks, with overlaps of parts in red."""

import itertools

import numpy as np
from numpy.typing import NDArray

from ..checks.allowance import Allowance
from ..checks.joint_sweep import Overlap, Pair, State, sweep_joints
from ..checks.part_distances import OutOfTime, Probe
from ..config import ProgramOptions
from ..render import render_object, to_png
from ..spec import GeomSpec, ObjectSpec, PartSpec, link_poses, pieces
from ..spec.convex import Piece
from ..spec.csg import faceted
from ..spec.mesh import Mesh
from ..spec.object import Material
from ..spec.pose import Pose

FAILED = "failed.png"
"""Name of the picture's file in a build's folder."""
RED, GHOST_ALPHA, SECTORS = (0.86, 0.08, 0.08, 1.0), 0.3, 24
_MARK = "overlap_mark"
_MIN_VOLUME_M3 = 1e-12


def failed_picture(
    spec: ObjectSpec, options: ProgramOptions, allowances: tuple[Allowance, ...] = ()
) -> bytes:
    """Return a PNG picture of an object that fails its checks.

    If parts overlap too deeply, the object is transparent, the overlaps are red, and the joints are
    at the positions that `deepest_overlap` returns. Otherwise all joints are at zero.
    """
    pairs, state = deepest_overlap(spec, options, allowances)
    marks = overlap_meshes(spec, pairs, state)
    return to_png(render_object(_with_marks(spec, marks, state) if marks else spec, state))


def deepest_overlap(
    spec: ObjectSpec, options: ProgramOptions, allowances: tuple[Allowance, ...] = ()
) -> tuple[list[Pair], State]:
    """Return pairs of parts that overlap too deeply, and the joint state in which they overlap.

    If parts overlap with all joints at zero, return all pairs that do. Otherwise, return the pair
    with the deepest overlap over all joint ranges.
    """
    try:
        sweep = sweep_joints(Probe(spec, options.check_timeout_s), options, allowances)
    except OutOfTime:
        return [], {}
    at_rest = sweep.too_deep(sweep.at_rest)
    if at_rest:
        return list(at_rest), {}
    in_motion: list[tuple[Pair, Overlap]] = [
        entry for swept in sweep.ranges for entry in sweep.too_deep(swept.deepest).items()
    ]
    if not in_motion:
        return [], {}
    pair, overlap = max(in_motion, key=lambda entry: entry[1].depth)
    return [pair], dict(overlap.state)


def overlap_meshes(spec: ObjectSpec, pairs: list[Pair], state: State) -> list[Mesh]:
    """Return the intersections of pairs of parts in a joint state, in the object's frame [m]."""
    import manifold3d

    poses = link_poses(spec, state)
    meshes = []
    for first, second in pairs:
        solids = [_hulls(spec.parts[k], poses[spec.parts[k].name]) for k in (first, second)]
        for first_hull, second_hull in itertools.product(*solids):
            separated = (first_hull.min(axis=0) >= second_hull.max(axis=0)) | (
                second_hull.min(axis=0) >= first_hull.max(axis=0)
            )
            if separated.any():
                continue
            hulls = [
                manifold3d.Manifold.hull_points(points) for points in (first_hull, second_hull)
            ]
            shared = hulls[0] ^ hulls[1]
            if shared.volume() < _MIN_VOLUME_M3:
                continue
            triangles = shared.to_mesh64()
            vertices = np.asarray(triangles.vert_properties)[:, :3].tolist()
            faces = np.asarray(triangles.tri_verts).tolist()
            mesh = Mesh(vertices=tuple(map(tuple, vertices)), faces=tuple(map(tuple, faces)))
            meshes.append(mesh)
    return meshes


def _hulls(part: PartSpec, pose: Pose) -> list[NDArray]:
    """Return the corners of each convex piece of a part in the object's frame [m], shape [n, 3]."""
    return [pose.then(local).apply(_corners(piece)) for _, piece, local in pieces(part)]


def _corners(piece: Piece) -> NDArray:
    if piece.kind == "mesh":
        return np.array(piece.vertices, float)
    if piece.kind == "box":
        return np.array(list(itertools.product((-1, 1), repeat=3))) * np.array(piece.size)
    return faceted(piece, SECTORS)


def _with_marks(spec: ObjectSpec, marks: list[Mesh], state: State) -> ObjectSpec:
    """Return a transparent copy of the object, with the overlap meshes on its first part."""
    transparent = tuple(
        material.model_copy(update={"rgba": (*material.rgba[:3], GHOST_ALPHA), "pattern": None})
        for material in spec.materials
    )
    root = spec.parts[0]
    to_root = link_poses(spec, state)[root.name].inverse()
    red = tuple(
        GeomSpec(
            name=f"{_MARK}_{k}",
            shape=mesh,
            pos=tuple(to_root.pos.tolist()),
            quat=tuple(to_root.quat.tolist()),
            material=_MARK,
            role="visual",
        )
        for k, mesh in enumerate(marks)
    )
    first = root.model_copy(update={"geoms": (*root.geoms, *red)})
    mark = Material(name=_MARK, density=1000.0, rgba=RED)
    return spec.model_copy(
        update={"materials": (*transparent, mark), "parts": (first, *spec.parts[1:])}
    )
