"""Unusual MJCF files and meshes, against MuJoCo, trimesh and known values."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from neoworld_mjx.export.importing import import_file
from neoworld_mjx.physics.mjcf import to_mjspec
from tests.export.test_against_mujoco import facts, inertial, own_model

BOX = "<geom type='box' size='.1 .1 .1'/>"
BLOCK = (
    "<asset><mesh name='m' vertex='0 0 0 .2 0 0 .2 .3 0 0 .3 0 0 0 .4 .2 0 .4 .2 .3 .4 0 .3 .4'"
    " {}/></asset><worldbody><body pos='0 0 1'><freejoint/><geom {} mesh='m'/></body></worldbody>"
)
WEDGE = BLOCK.replace(".2 .3 0 0 .3 0 0 0 .4 .2 0 .4 .2 .3 .4 0 .3 .4", "0 .3 0 0 0 .4")
MJCF = {
    "capsule from a mesh": BLOCK.format("", "type='capsule'"),
    "mirrored mesh": WEDGE.format("scale='-1 1 2'", "type='mesh'"),
    "reference pose": WEDGE.format("refpos='.1 .2 .3' refquat='1 1 0 0'", "type='mesh'"),
    "include": "<include file='part.xml'/><worldbody><body pos='2 0 0'><freejoint/>"
    f"{BOX}</body></worldbody>",
    "attach": "<asset><model name='s' file='sub.xml'/></asset><worldbody><body><freejoint/>"
    f"{BOX}<frame pos='0 0 .4' euler='0 0 45'><attach model='s' body='tool' prefix='t_'/></frame>"
    "</body></worldbody>",
}
"""Contents of <mujoco>, by kind of file."""
PART = (
    "<mujocoinclude><default><geom density='100'/></default><worldbody><body name='p'><freejoint/>"
    f"{BOX}</body></worldbody></mujocoinclude>"
)
SUB = (
    "<mujoco model='sub'><compiler angle='radian'/><worldbody><body name='tool' pos='9 9 9'>"
    f"{BOX}<body name='jaw' pos='0 0 .2'><joint name='j' type='slide' axis='1 0 0' range='0 .05'/>"
    f"{BOX}</body></body></worldbody></mujoco>"
)


@pytest.mark.parametrize("kind", MJCF)
def test_mjcf_is_what_mujoco_compiles(tmp_path, kind):
    (tmp_path / "part.xml").write_text(PART)
    (tmp_path / "sub.xml").write_text(SUB)
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco>{MJCF[kind]}</mujoco>")
    reference = mujoco.MjModel.from_xml_path(str(path))
    own, _, _ = own_model(path)
    expected, actual = facts(reference), facts(own)
    names = expected.keys() - ({"geoms"} if reference.ngeom == reference.nmesh else set())
    for name in names:
        assert np.allclose(actual[name], expected[name], atol=2e-5), name
    assert np.allclose(whole_inertia(own), whole_inertia(reference), rtol=2e-3, atol=1e-7)


def whole_inertia(model: mujoco.MjModel) -> np.ndarray:
    """Return the inertia of all bodies about their center of mass, shape [3, 3]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    offset = data.xipos - data.subtree_com[0]
    turn = data.ximat.reshape(-1, 3, 3)
    total = np.einsum("bij,bj,bkj->ik", turn, model.body_inertia, turn)
    square = np.einsum("b,bi,bi->", model.body_mass, offset, offset) * np.eye(3)
    return total + square - np.einsum("b,bi,bj->ij", model.body_mass, offset, offset)


def block(size=(0.2, 0.3, 0.4), at=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    return trimesh.creation.box(size, transform=trimesh.transformations.translation_matrix(at))


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(meshes)


def half_inverted() -> trimesh.Trimesh:
    faces = block().faces
    return trimesh.Trimesh(block().vertices, np.vstack([faces[:6], faces[6:, ::-1]]), process=False)


SLIVER = trimesh.Trimesh([[0, 0, 0.2], [1e-9, 0, 0.2], [0, 1e-9, 0.2]], [[0, 1, 2]])
OBJ = """mtllib m.mtl
v 0 0 0
v .2 0 0
v .2 .3 0
v 0 .3 0
v 0 0 .4
v .2 0 .4
v .2 .3 .4
v 0 .3 .4
vt 0 0
vn 0 0 1
usemtl red
f 4 3 2 1
f 5/1/1 6/1/1 7/1/1 8/1/1
usemtl blue
f 1 2 6 5
f -7 -6 -2 -3
f 3 4 8 7
f 4 1 5 8
"""
MTL = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nTr .5\n"
BINARY = block().export(file_type="stl")
MESHES = {
    "touching bodies.stl": (joined(block(), block(at=(0.2, 0, 0))), 0.048),
    "three in a row.ply": (joined(*(block(at=(0.2 * k, 0, 0)) for k in range(3))), 0.072),
    "bodies that share part of a face.stl": (
        joined(block((0.2, 0.2, 0.2)), block((0.4, 0.4, 0.1), (0, 0, 0.15))),
        0.024,
    ),
    "equal triangles.stl": (joined(block(), block()), 0.024),
    "half of the triangles inverted.stl": (half_inverted(), 0.024),
    "a triangle of no size.stl": (joined(block(), SLIVER), 0.024),
    "far from the origin.stl": (block(at=(500, 0, 0)), 0.024),
    "quads and negative indices.obj": (OBJ, 0.024),
    "lines that continue.obj": (OBJ.replace("4 3 2", "4 3 \\\n2").replace("\n", "\r\n"), 0.024),
    "text.stl": (trimesh.exchange.stl.export_stl_ascii(block()), 0.024),
    "binary that begins with solid.stl": (b"solid name" + BINARY[10:], 0.024),
}
"""File and volume [m^3], by kind and suffix."""


@pytest.mark.parametrize("kind", MESHES)
def test_colliders_of_meshes_have_their_volume(tmp_path, kind):
    content, volume = MESHES[kind]
    path = tmp_path / f"mesh{Path(kind).suffix}"
    (tmp_path / "m.mtl").write_text(MTL)
    if isinstance(content, trimesh.Trimesh):
        content = content.export(file_type=path.suffix[1:])
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    read = import_file(urdf(tmp_path / "a.urdf", path.name, mass=0))
    own = to_mjspec(read.scene).compile()
    assert own.body_mass.sum() == pytest.approx(400 * volume, rel=0.02)
    assert np.allclose(
        extent(own), np.ptp(trimesh.load(path, force="mesh").bounds, axis=0), atol=1e-3
    )
    if path.suffix == ".obj":
        assert {m.rgba for m in read.spec.materials} >= {(1, 0, 0, 1), (0, 0, 1, 0.5)}


def urdf(path: Path, mesh: str, mass: float = 2, scale: str = "1 1 1") -> Path:
    shape = f"<geometry><mesh filename='{mesh}' scale='{scale}'/></geometry>"
    stated = inertial(mass) if mass else ""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"<robot name='r'><link name='a'>{stated}<visual>{shape}</visual><collision>{shape}"
        "</collision></link></robot>"
    )
    return path


def extent(model: mujoco.MjModel) -> np.ndarray:
    """Return the edges of the box around all geoms [m], of which meshes and boxes are known."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = []
    for g in range(model.ngeom):
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            first = model.mesh_vertadr[model.geom_dataid[g]]
            count = model.mesh_vertnum[model.geom_dataid[g]]
            local = model.mesh_vert[first : first + count]
        else:
            local = np.array(list(np.ndindex(2, 2, 2))) * 2 - 1.0
            local = local * model.geom_size[g]
        points.append(local @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g])
    return np.ptp(np.concatenate(points), axis=0)
