"""Assets of few bytes that ask for gigabytes or hours."""

import json
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

TEXTURE = '<texture name="t" type="2d" file="p.png"/><material name="m" texture="t"/>'
SHOWN = '<geom size=".1" material="m"/>'
SPHERE = '<geometry><sphere radius="1"/></geometry>'
BALL = '<geom size=".1"/>'
LINK = '<robot name="r"><link name="a"><visual>{}</visual></link></robot>'
Writer = Callable[[Path], str]
"""Writes an asset into a folder and returns its name there."""


def _text(name: str, text: str) -> Writer:
    def write(folder: Path) -> str:
        (folder / name).write_text(text, encoding="utf-8")
        return name

    return write


def _mesh(name: str, data: Callable[[], bytes]) -> Writer:
    def write(folder: Path) -> str:
        (folder / name).write_bytes(data())
        robot = LINK.format(f'<geometry><mesh filename="{name}"/></geometry>')
        return _text(f"{name}.urdf", robot)(folder)

    return write


def mjcf(body: str, before: str = "") -> str:
    """Return an MJCF file with one body."""
    return f"<mujoco>{before}<worldbody><body name='b'>{body}</body></worldbody></mujoco>"


def glb(document: dict[str, Any], data: bytes) -> bytes:
    """Return a binary glTF file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    size = 28 + len(text) + len(data)
    return (
        struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(data), 0x004E4942)
        + data
    )


def _gltf(nodes: int, primitives: int, count: int) -> bytes:
    """Return a mesh that many nodes instance, or many primitives that share an accessor."""
    primitive = {"attributes": {"POSITION": 0}, "mode": 4}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [primitive] * primitives}],
        "buffers": [{"byteLength": 12 * count}],
        "bufferViews": [{"buffer": 0, "byteLength": 12 * count}],
        "accessors": [{"bufferView": 0, "count": count, "type": "VEC3", "componentType": 5126}],
    }
    return glb(document, bytes(12 * count))


def png(width: int, height: int, *, depth: int = 8, grey: bool = False) -> bytes:
    """Return a black PNG, of RGB unless `grey`."""
    row = bytes(1 + (1 if grey else 3) * width * depth // 8)
    pack, end = zlib.compressobj(1, zlib.DEFLATED, -15), zlib.compressobj(1, zlib.DEFLATED, -15)
    # Every row is a block of its own, so that one is packed for all; zeros have a simple checksum.
    block = pack.compress(row) + pack.flush(zlib.Z_FULL_FLUSH)
    checksum = (len(row) * height % 65521) << 16 | 1
    rows = b"\x78\x01" + block * height + end.flush() + struct.pack(">I", checksum)
    head = struct.pack(">IIBBBBB", width, height, depth, 0 if grey else 2, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", rows), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


HFIELD = (
    '<hfield name="h" file="p.png" size="1 1 1 1"/>',
    '<geom type="hfield" hfield="h"/>',
)


def _pictured(
    width: int, height: int, before: str = TEXTURE, body: str = SHOWN, **kind: Any
) -> Writer:
    def write(folder: Path) -> str:
        (folder / "p.png").write_bytes(png(width, height, **kind))
        return _text("pictured.xml", mjcf(body, f"<asset>{before}</asset>"))(folder)

    return write


def _crate(folder: Path, declare: int = 150_000_000) -> str:
    from pxr import Sdf

    count = 5003
    layer = Sdf.Layer.CreateAnonymous(".usda")
    numbers = ", ".join(["0"] * count)
    layer.ImportFromString(
        f'#usda 1.0\ndef Mesh "m"\n{{\nint[] faceVertexCounts = [3]\n'
        f"int[] faceVertexIndices = [{numbers}]\npoint3f[] points = [(0, 0, 0)]\n}}\n"
    )
    path = folder / "crate.usdc"
    layer.Export(str(path))
    data, declared = path.read_bytes(), struct.pack("<Q", count)
    assert declared in data
    path.write_bytes(data.replace(declared, struct.pack("<Q", declare)))
    return path.name


def _polygon(corners: int) -> bytes:
    face = " ".join(str(1 + k % 4) for k in range(corners))
    return f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf {face}\n".encode()


def _groups(count: int) -> bytes:
    faces = "".join(f"g g{k}\nusemtl m{k}\nf 1 2 {3 + k % 2}\n" for k in range(count))
    return f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{faces}".encode()


def _bodies(count: int) -> str:
    cube = 'def Cube "c{}" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])\n{{\n}}'
    return "#usda 1.0\n" + "\n".join(cube.format(k) for k in range(count))


def _tendon(sites: int) -> str:
    here = "".join(f'<site name="s{k}" pos="{k % 7} 0 {k % 11}"/>' for k in range(sites))
    path = "".join(f'<site site="s{k}"/>' for k in range(sites))
    text = mjcf(BALL + here)
    return text.replace("</mujoco>", f"<tendon><spatial>{path}</spatial></tendon></mujoco>")


ASSETS: dict[str, Writer] = {
    "nodes that share a mesh": _mesh("nodes.glb", lambda: _gltf(3000, 1, 99_999)),
    "primitives that share an accessor": _mesh("prims.glb", lambda: _gltf(1, 3000, 99_999)),
    "polygon of many corners": _mesh("polygon.obj", lambda: _polygon(2_000_000)),
    "many groups": _mesh("groups.obj", lambda: _groups(60_000)),
    "origins": _text("origins.urdf", LINK.format('<origin xyz="0 0 0"/>' * 190_000)),
    "spheres": _text("spheres.urdf", LINK.format(f"{SPHERE}</visual><visual>" * 60_000 + SPHERE)),
    "tendon": _text("tendon.xml", _tendon(50_000)),
    "texture": _pictured(15_000, 15_000),
    "texture, larger": _pictured(26_000, 26_000),
    "texture, grey": _pictured(26_000, 26_000, grey=True),
    "texture, 16 bits": _pictured(20_000, 20_000, depth=16),
    "height field": _pictured(15_000, 15_000, *HFIELD),
    "height field, larger": _pictured(26_000, 26_000, *HFIELD),
    "height field, grey": _pictured(26_000, 26_000, *HFIELD, grey=True),
    "height field, 16 bits": _pictured(20_000, 20_000, *HFIELD, grey=True, depth=16),
    "rigid bodies": _text("bodies.usda", _bodies(20_000)),
    "declared indices": _crate,
}
"""Every known asset that exceeded ten seconds or 500 MB."""


def grown(draw: random.Random, home: Path) -> None:
    """Read an asset of a kind that grows, with a size from one to far too much."""
    from neoworld_mjx.export.importing_scene import import_file

    def size(low: float, high: float) -> int:
        return round(10 ** draw.uniform(low, high))

    kinds: list[Callable[[], Writer]] = [
        lambda: _mesh("a.glb", lambda: _gltf(size(0, 4), 1, 3 * size(0, 4.5))),
        lambda: _mesh("a.glb", lambda: _gltf(1, size(0, 4), 3 * size(0, 4.5))),
        lambda: _mesh("a.obj", lambda: _polygon(3 + size(0, 6))),
        lambda: _mesh("a.obj", lambda: _groups(size(0, 4.5))),
        lambda: _text("a.urdf", LINK.format('<origin xyz="0 0 0"/>' * size(0, 5) + SPHERE)),
        lambda: _text("a.urdf", LINK.format(f"{SPHERE}</visual><visual>" * size(0, 4) + SPHERE)),
        lambda: _text("a.xml", _tendon(size(0, 4))),
        lambda: _text("a.xml", star(size(0, 3.2), BALL)),
        lambda: _text("a.xml", _grid(*(size(0, 2.4) for _ in range(3)))),
        lambda: _text("a.usda", _bodies(size(0, 4))),
        lambda: lambda folder: _crate(folder, draw.choice([1 << k for k in range(10, 63)])),
        lambda: _pictured(size(1, 4), size(1, 4)),
    ]
    import_file(home / draw.choice(kinds)()(home))


def star(count: int, shape: str) -> str:
    """Return an MJCF body with a number of children on hinges."""
    joints = "".join(f'<body name="b{k}"><joint name="j{k}"/>{shape}</body>' for k in range(count))
    return mjcf(shape + joints)


def _grid(x: int, y: int, z: int) -> str:
    return mjcf(
        f'<flexcomp name="f" type="grid" count="{x} {y} {z}" spacing=".1 .1 .1" dim="3"/>{BALL}'
    )
