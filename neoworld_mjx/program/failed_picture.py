"""Picture of an object that fails its checks: what can be drawn, with overlaps in red."""

import itertools

import numpy as np
from numpy.typing import NDArray

from ..checks.allowance import Allowance
from ..checks.joint_sweep import Overlap, Pair, State, sweep_joints
from ..checks.part_distances import OutOfTime, Probe
from ..config import ProgramOptions
from ..render import render_object, to_png
from ..spec import GeomSpec, ObjectSpec, PartSpec, link_poses
from ..spec.convex import Piece
from ..spec.csg import faceted
from ..spec.mesh import Mesh
from ..spec.object import Material
from ..spec.pose import Pose

FAILED = "failed.png"
"""Name of the picture in the folder of a build."""
RED, GHOST_ALPHA, SECTORS = (0.86, 0.08, 0.08, 1.0), 0.3, 24
_MARK = "overlap_mark"
_LEAST_M3 = 1e-12


def failed_picture(
    spec: ObjectSpec, options: ProgramOptions, allowances: tuple[Allowance, ...] = ()
) -> bytes:
    """Return a PNG of an object; where parts overlap too deep, see-through with the overlap in red.

    Joints are in the state in which the overlap is deepest, or closed if nothing overlaps.

    Args:
        spec: the object.
        options: thresholds of the joint sweep.
        allowances: overlaps that the program declares.
    """
    pairs, state = deepest_overlap(spec, options, allowances)
    marks = overlap_meshes(spec, pairs, state)
    return to_png(render_object(_marked(spec, marks, state) if marks else spec, state))


def deepest_overlap(
    spec: ObjectSpec, options: ProgramOptions, allowances: tuple[Allowance, ...] = ()
) -> tuple[list[Pair], State]:
    """Return the pairs of parts that overlap too deep together, and the joint state they do so in.

    Overlaps at rest come first; else the deepest one over the range of any joint.
    """
    try:
        sweep = sweep_joints(Probe(spec, options.check_timeout_s), options, allowances)
    except OutOfTime:
        return [], {}
    at_rest = sweep.too_deep(sweep.at_rest)
    if at_rest:
        return list(at_rest), {}
    moved: list[tuple[Pair, Overlap]] = [
        entry for swept in sweep.ranges for entry in sweep.too_deep(swept.deepest).items()
    ]
    if not moved:
        return [], {}
    pair, overlap = max(moved, key=lambda entry: entry[1].depth)
    return [pair], dict(overlap.state)


def overlap_meshes(spec: ObjectSpec, pairs: list[Pair], state: State) -> list[Mesh]:
    """Return what pairs of parts share, as posed, in the object's frame."""
    import manifold3d

    poses = link_poses(spec, state)
    meshes = []
    for first, second in pairs:
        solids = [_hulls(spec.parts[k], poses[spec.parts[k].name]) for k in (first, second)]
        for one, other in itertools.product(*solids):
            if (one.min(axis=0) >= other.max(axis=0)).any():
                continue
            if (other.min(axis=0) >= one.max(axis=0)).any():
                continue
            hulls = [manifold3d.Manifold.hull_points(points) for points in (one, other)]
            shared = hulls[0] ^ hulls[1]
            if shared.volume() < _LEAST_M3:
                continue
            triangles = shared.to_mesh64()
            corners = np.asarray(triangles.vert_properties)[:, :3].tolist()
            faces = np.asarray(triangles.tri_verts).tolist()
            meshes.append(
                Mesh(
                    vertices=tuple((x, y, z) for x, y, z in corners),
                    faces=tuple((a, b, c) for a, b, c in faces),
                )
            )
    return meshes


def _hulls(part: PartSpec, at: Pose) -> list[NDArray]:
    """Return the corners [n, 3] m of a part's convex pieces in the object's frame."""
    return [
        at.then(geom.pose())
        .then(Pose(np.array(piece.pos), np.array(piece.quat)))
        .apply(_corners(piece))
        for geom in part.geoms
        if geom.role != "visual"
        for piece in geom.shape.pieces()
    ]


def _corners(piece: Piece) -> NDArray:
    if piece.kind == "mesh":
        return np.array(piece.vertices, float)
    if piece.kind == "box":
        return np.array(list(itertools.product((-1, 1), repeat=3))) * np.array(piece.size)
    return faceted(piece, SECTORS)


def _marked(spec: ObjectSpec, marks: list[Mesh], state: State) -> ObjectSpec:
    """Return the object see-through, with the marks on its first part."""
    ghosts = tuple(
        material.model_copy(update={"rgba": (*material.rgba[:3], GHOST_ALPHA), "pattern": None})
        for material in spec.materials
    )
    root = spec.parts[0]
    back = link_poses(spec, state)[root.name].inverse()
    red = tuple(
        GeomSpec(
            name=f"{_MARK}_{k}",
            shape=mesh,
            pos=tuple(back.pos.tolist()),
            quat=tuple(back.quat.tolist()),
            material=_MARK,
            role="visual",
        )
        for k, mesh in enumerate(marks)
    )
    first = root.model_copy(update={"geoms": (*root.geoms, *red)})
    mark = Material(name=_MARK, density=1000.0, rgba=RED)
    return spec.model_copy(update={"materials": (*ghosts, mark), "parts": (first, *spec.parts[1:])})
