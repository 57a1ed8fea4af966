"""Ground-truth joints and surfaces of objects in the layout of PartNet-Mobility.

    PATH/ID/mobility.urdf            links, joints and their meshes
    PATH/ID/meta.json                "model_cat": the category
    PATH/ID/semantics.txt            lines "link_0 hinge door": link, kind of joint, part's name
    PATH/ID/textured_objs/*.obj

Nothing of the data set is part of this project. Its objects face -x in their URDF's world.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.mechanism import Link, LinkShape, Mechanism
from neoworld_mjx.export.read_urdf import read_urdf
from neoworld_mjx.io import read_object, read_untrusted_text
from neoworld_mjx.io.names import identifier
from neoworld_mjx.spec.base_shape import BaseShape

from ..measures import ObjectTruth, canonical_points
from ..measures.object_truth import Front, truth_from
from ..measures.surface_measure import SAMPLES, sampled

URDF, META, SEMANTICS = "mobility.urdf", "meta.json", "semantics.txt"
EXPECTED = f"ID/{URDF} with ID/{META}, ID/{SEMANTICS} and ID/textured_objs/*.obj beside it"


class TrueObject(NamedTuple):
    """Ground truth of an object."""

    truth: ObjectTruth
    points: NDArray | None
    """Samples of its surface [n, 3] m in its canonical frame, if there are any."""
    category: str = ""


def partnet_folders(path: Path) -> dict[str, Path]:
    """Return the folders of objects by id, in a folder or one level below.

    Raises:
        SpecError: there are none; says what is expected.
    """
    files = sorted(path.glob(f"*/{URDF}")) or sorted(path.glob(f"*/*/{URDF}"))
    if not files:
        raise SpecError(f"{path} is no folder of PartNet-Mobility: expected {EXPECTED}")
    return {file.parent.name: file.parent for file in files}


def partnet_object(
    folder: Path, *, front: Front = "-x", samples: int = SAMPLES, seed: int = 1
) -> TrueObject:
    """Read joints, category and visible surface of an object.

    Joints without a range or without a visible child are omitted.

    Args:
        folder: of the object; its name is the object's.
        front: direction in the URDF's world in which the object's front faces.
        samples: number of samples of the surface.
        seed: of the samples, another than that of reconstructed objects: the same surface is
            sampled twice.

    Raises:
        SpecError: a file cannot be read, or the object shows nothing.
    """
    mechanism = read_urdf(folder / URDF)
    meshes = {name: _meshes(link) for name, link in mechanism.links.items()}
    every = [mesh for of_link in meshes.values() for mesh in of_link]
    if not every:
        raise SpecError(f"{folder / URDF} has no visible geometry")
    parts = _parts(folder)
    joints = []
    for joint in mechanism.joints:
        moved_meshes = [m for name in _descendants(mechanism, joint.child) for m in meshes[name]]
        if joint.type == "fixed" or not moved_meshes:
            continue
        limits = None if joint.type == "continuous" else (joint.lower, joint.upper)
        joints.append(
            {
                "name": joint.name,
                "type": joint.type,
                "axis": joint.axis,
                "pivot": joint.pos,
                "limits": limits,
                "parent": parts.get(joint.parent, joint.parent),
                "child": parts.get(joint.child, joint.child),
                "moving_box": _box(moved_meshes),
            }
        )
    data = {"name": folder.name, "front": front, "box": _box(every), "joints": joints}
    truth = truth_from(data, str(folder / URDF))
    points = canonical_points(sampled(every, samples, seed), truth)
    return TrueObject(truth, points, _category(folder))


def _category(folder: Path) -> str:
    if not (folder / META).exists():
        return ""
    return identifier(str(read_object(folder / META, SpecError).get("model_cat", "")), "object")


def _parts(folder: Path) -> dict[str, str]:
    """Return the names of parts by link."""
    file = folder / SEMANTICS
    if not file.exists():
        return {}
    lines = [line.split() for line in read_untrusted_text(file, SpecError).splitlines()]
    return {words[0]: identifier(words[2], "part") for words in lines if len(words) >= 3}


def _descendants(mechanism: Mechanism, child: str) -> list[str]:
    """Return a link and its descendants."""
    links, waiting = [], [child]
    while waiting:
        links.append(waiting.pop())
        waiting += [joint.child for joint in mechanism.joints if joint.parent == links[-1]]
    return links


def _meshes(link: Link) -> list[trimesh.Trimesh]:
    visuals = [shape for shape in link.shapes if shape.role != "collision"] or link.shapes
    return [_mesh(shape) for shape in visuals]


def _mesh(item: LinkShape) -> trimesh.Trimesh:
    """Return the surface of a shape in the file's frame at rest."""
    shape = item.shape
    vertices, faces = shape.surface() if isinstance(shape, BaseShape) else shape
    rotation, offset = item.frame[:3, :3], item.frame[:3, 3]
    return trimesh.Trimesh(np.asarray(vertices) @ rotation.T + offset, faces, process=False)


def _box(meshes: list[trimesh.Trimesh]) -> list[list[float]]:
    corners = np.vstack([mesh.bounds for mesh in meshes])
    return [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()]
