"""Files of few bytes that stand for much: refused soon, by one message."""

import os
import struct

import numpy as np
import pytest

from neoworld_mjx.config import FileOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export import import_mjcf, import_urdf
from neoworld_mjx.export.load_mesh import load_mesh
from neoworld_mjx.io import bounded_by

BALL = '<geom size=".1"/>'
MJCF = {
    "grid": (
        "",
        '<flexcomp name="f" type="grid" count="200 200 200" spacing=".1 .1 .1" dim="3"/>',
        r"takes over|cannot be read",
    ),
    "sensor": ('<sensor><user dim="1000000000"/></sensor>', BALL, "the limit is 1000"),
    "size": ('<size memory="100000G"/>', BALL, "refused by MuJoCo|MuJoCo cannot read"),
    "user data": ('<size nuserdata="1000000000"/>', BALL, "the limit is 10000"),
    "texture": (
        '<asset><texture name="t" type="2d" builtin="flat" width="99999" height="1"/></asset>',
        BALL,
        "the limit is 16384",
    ),
    "torus": (
        '<asset><mesh name="m" builtin="supertorus" params="4000 0.5 1 1"/></asset>',
        '<geom type="mesh" mesh="m"/>',
        "takes over|cannot be read",
    ),
    "replicate": (
        "",
        '<replicate count="900"><replicate count="900"><geom size=".1"/></replicate></replicate>',
        "expands to more than 200000 elements",
    ),
    "geoms": ("", '<replicate count="1000">' + BALL * 20 + "</replicate>", "10000 elements <geom>"),
}


@pytest.mark.parametrize("name", MJCF)
def test_mjcf(tmp_path, name):
    before, inside, said = MJCF[name]
    path = tmp_path / "a.xml"
    path.write_text(
        f"<mujoco>{before}<worldbody><body name='b'>{inside}</body></worldbody></mujoco>"
    )
    with bounded_by(FileOptions(timeout_s=4.0)), pytest.raises(SpecError, match=said) as caught:
        import_mjcf(path)
    assert str(path) in str(caught.value)


def test_mjcf_with_what_could_be_a_bomb_and_is_none(tmp_path):
    path = tmp_path / "a.xml"
    texture = '<asset><texture name="t" type="2d" builtin="flat" width="8" height="8"/></asset>'
    path.write_text(f"<mujoco>{texture}<worldbody><body>{BALL}</body></worldbody></mujoco>")
    assert len(import_mjcf(path).spec.parts) == 1


def test_a_robot_of_too_many_links(tmp_path):
    path = tmp_path / "a.urdf"
    links = "".join(f'<link name="l{i}"/>' for i in range(20_000))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(19_999)
    )
    path.write_text(f'<robot name="r">{links}{joints}</robot>')
    with pytest.raises(SpecError, match="more than 400 elements <link>"):
        import_urdf(path)


@pytest.mark.parametrize("suffix", ["urdf", "xml", "mjcf"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_xml_that_is_no_regular_file(tmp_path, suffix, kind):
    path = tmp_path / f"a.{suffix}"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(SpecError, match="a pipe or device, not a regular file"):
        (import_urdf if suffix == "urdf" else import_mjcf)(path)


def _ply(vertices: int, faces: str, claimed: int | None = None) -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {claimed or vertices}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += (
        f"element face {faces.count('3 ')}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = "".join(f"{i} {i * i} {i**3}\n" for i in range(vertices))
    return (head + rows + faces).encode()


def _glb(accessor: str) -> bytes:
    text = (
        '{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],'
        '"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[' + accessor + "]}"
    ).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text


DAE = '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">'
MESHES = {
    "a.ply": [
        (_ply(4, "3 0 1 9\n"), "missing vertex|not a mesh"),
        (_ply(4, "3 0 1 -7\n"), "missing vertex|not a mesh"),
        (_ply(4, "3 0 1 2\n", 10**12), "declares more elements than it has bytes"),
    ],
    "a.glb": [
        (
            _glb('{"count":10000000000,"type":"VEC3","componentType":5126}'),
            "declares more vertices",
        ),
        (_glb('{"count":3,"type":"VEC3","componentType":5126}'), "declares more vertices"),
        (b"glTF" + bytes(16), "not glTF"),
    ],
    "a.gltf": [(b'{"accessors": 3}', "not glTF|not a mesh"), (b"[" * 100_000, "not glTF")],
    "a.dae": [
        (f'<!DOCTYPE x [<!ENTITY a "b">]>{DAE}</COLLADA>'.encode(), "document type or entities"),
        ((DAE + '<instance_node url="#a"/>' * 40 + "</COLLADA>").encode(), "node instances"),
    ],
    "a.stl": [(bytes(80) + struct.pack("<I", 2**31) + bytes(50), "not a mesh|no triangles")],
    "a.obj": [
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "missing vertex|not a mesh"),
        (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite|not a mesh"),
    ],
}


@pytest.mark.parametrize(
    ("name", "data", "said"), [(name, *case) for name, cases in MESHES.items() for case in cases]
)
def test_meshes(tmp_path, name, data, said):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(SpecError, match=said) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)


def test_a_gltf_reaches_no_file_outside_of_its_folder(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "secret.bin").write_bytes(np.zeros(9, np.float32).tobytes())
    text = (
        '{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],'
        '"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],'
        '"buffers":[{"byteLength":36,"uri":"../secret.bin"}],'
        '"bufferViews":[{"buffer":0,"byteLength":36}],'
        '"accessors":[{"bufferView":0,"count":3,"type":"VEC3","componentType":5126}]}'
    )
    (home / "a.gltf").write_text(text)
    with pytest.raises(SpecError, match="outside its folder"):
        load_mesh(home / "a.gltf")
