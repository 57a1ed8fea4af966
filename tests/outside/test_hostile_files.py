"""Hostile and damaged files of every kind: one clear message, bounded memory, nothing outside."""

import ast
import ctypes
import io
import json
import os
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import BaseModel

from neoworld_mjx.config import FileOptions, load_config
from neoworld_mjx.errors import NeoWorldError, PhotoError, RunError, SpecError
from neoworld_mjx.export.importing import import_file
from neoworld_mjx.io import bounded_by, open_image, read_arrays, read_json, read_model
from neoworld_mjx.io.limited_worker import call_limited
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.spec import Box, SceneObject, SceneSpec, read_scene, single_object_scene
from tests.support.mechanisms import single

LIBRARY = Path(__file__).parents[2] / "neoworld_mjx"
SMALL = FileOptions(max_file_mib=16, timeout_s=2.0, memory_mib=300)
TOO_MUCH = r"takes over|cannot be read|Could not allocate memory"
"""Messages of the limited worker, and of MuJoCo in it."""
BALL = '<geom size=".1"/>'
BOX = "<collision><geometry><box size='1 1 1'/></geometry></collision>"


class Pair(BaseModel):
    a: int
    b: list = []


def mjcf(body: str, before: str = "") -> str:
    return f"<mujoco>{before}<worldbody><body name='b'>{body}</body></worldbody></mujoco>"


def star(count: int) -> str:
    hinges = (f'<body name="b{k}"><joint name="j{k}"/>{BALL}</body>' for k in range(count))
    return mjcf(BALL + "".join(hinges))


def urdf(*content: str) -> str:
    return f'<robot name="r">{"".join(content)}</robot>'


def mesh_urdf(file: str) -> str:
    return urdf(
        f"<link name='a'><visual><geometry><mesh filename='{file}'/></geometry></visual></link>"
    )


def png(width: int, height: int) -> bytes:
    """Return a black RGB image of some kilobytes."""
    data, row = zlib.compressobj(1), bytes(1 + 3 * width)
    rows = b"".join(data.compress(row) for _ in range(height)) + data.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in chunks
    )


def gltf(accessor: dict[str, Any], uri: str | None = None, nodes: int = 1) -> str:
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(nodes))}],
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"type": "VEC3", "componentType": 5126, **accessor}],
    }
    if uri is not None:
        size = 12 * accessor["count"]
        document["buffers"] = [{"byteLength": size, "uri": uri}]
        document["bufferViews"] = [{"buffer": 0, "byteLength": size}]
    return json.dumps(document)


def npz(shape: tuple[int, ...], data: bytes = b"", kind: str = "<f8") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    header = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header + data)
    return whole.getvalue()


def json_of(path: Path) -> Any:
    return read_json(path, SpecError)


def model_of(path: Path) -> Any:
    return read_model(path, Pair, SpecError, "a pair")


def arrays_of(path: Path) -> Any:
    return read_arrays(path, RunError)


BOMB = "a: &a [x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in ("ab", "bc", "cd")
)
WIDE = {"bufferView": 0, "count": 3000}
Row = tuple[str, str | bytes | Callable[[], str | bytes], Callable[[Path], Any], str]
FILES: dict[str, Row] = {
    # JSON, YAML, arrays and tables.
    "deep": ("a.json", "[" * 400 + "]" * 400, json_of, "nested over 100 levels deep"),
    "deep objects": ("a.json", '{"a":' * 200 + "1" + "}" * 200, json_of, "nested over 100 levels"),
    "values": ("a.json", lambda: "[" + "0," * 4_000_000 + "0]", json_of, "over 4000000 values"),
    "large": ("a.json", lambda: "0" * (17 << 20), json_of, "it has 17 MiB; the limit is 16 MiB"),
    "surrogate": ("a.json", '"\\ud800"', json_of, "unpaired surrogate"),
    "constant": ("a.json", "NaN", json_of, "not JSON: NaN"),
    "digits": ("a.json", "9" * 5000, json_of, "not JSON"),
    "cut off": ("a.json", "[1,", json_of, "not JSON"),
    "binary": ("a.json", b"\xff\xfe", json_of, "not a text file"),
    "schema": ("a.json", '{"a": "x"}', model_of, "is not a pair: a: "),
    "alias": ("a.yaml", BOMB, load_config, r"holds an alias \(\*name\): write out the values"),
    "deep yaml": ("a.yaml", "- " * 100_000, load_config, "nested over 100 levels"),
    "flow yaml": ("a.yaml", "{a: " * 50_000, load_config, "nested over 100 levels"),
    "tag": ("a.yaml", "!!python/object/apply:os.getcwd []", load_config, "not valid YAML"),
    "long yaml": ("a.yaml", "seed: 1\n" + "#" * 300_000, load_config, "the limit is 0.25 MiB"),
    "infinite": ("a.yaml", "refine: {rollout: {duration_s: .inf}}", load_config, "duration_s"),
    "vast": ("a.yaml", "refine: {cem: {population: 1000000000000}}", load_config, "population"),
    "huge": ("a.npz", npz((10**13,)), arrays_of, "declares 80000000000000 bytes"),
    "negative": ("a.npz", npz((-1,)), arrays_of, "invalid shape|declares"),
    "pickle": ("a.npz", npz((1,), bytes(8), "|O"), arrays_of, "Python objects"),
    "zip bomb": ("a.npz", lambda: npz((2**22,), bytes(2**25)), arrays_of, "unpacks to 32 MiB"),
    "no zip": ("a.npz", b"PK\x03\x04" + bytes(100), arrays_of, "no readable arrays"),
    # Pictures.
    "pixels": ("a.png", lambda: png(12_000, 12_000), load_photo, "144 megapixels; the limit"),
    "decoding": ("a.png", lambda: png(11_000, 11_000), load_photo, "memory"),
    # URDF, MJCF, USD and meshes.
    "entities": (
        "a.urdf",
        '<!DOCTYPE x [<!ENTITY a "b">]><robot name="&a;"/>',
        import_file,
        "document type or entities",
    ),
    "nested": ("a.xml", "<a>" * 150 + "</a>" * 150, import_file, "nested more than 100 elements"),
    "nan": (
        "a.urdf",
        urdf("<link name='a'><inertial><mass value='nan'/></inertial></link>"),
        import_file,
        "value='nan' is not a finite number",
    ),
    "links": (
        "a.urdf",
        urdf(*(f"<link name='l{k}'>{BOX}</link>" for k in range(401)))
        .replace("</robot>", "")
        + "".join(
            f"<joint name='j{k}' type='fixed'><parent link='l0'/><child link='l{k}'/></joint>"
            for k in range(1, 401)
        )
        + "</robot>",
        import_file,
        "401 links; the limit is 400",
    ),
    "grid": (
        "a.xml",
        mjcf('<flexcomp name="f" type="grid" count="200 200 200" spacing=".1 .1 .1" dim="3"/>'),
        import_file,
        TOO_MUCH,
    ),
    "memory": ("a.xml", mjcf(BALL, '<size nuserdata="1000000000"/>'), import_file, TOO_MUCH),
    "replicate": (
        "a.xml",
        mjcf('<replicate count="900"><replicate count="900">' + BALL + "</replicate></replicate>"),
        import_file,
        TOO_MUCH + "|the limit is",
    ),
    "shapes": ("a.xml", mjcf(BALL * 2001), import_file, "2001 shapes; the limit is 2000"),
    "usd": ("a.usda", "#usda 1.0", import_file, "written, not read; convert it to MJCF, URDF"),
    "unknown": ("a.blend", b"BLENDER", import_file, r"files that can be read: .*\.urdf"),
    "ply": (
        "a.ply",
        "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\n"
        "property float y\nproperty float z\nend_header\n",
        import_file,
        "is not a mesh|has no triangles",
    ),
    "accessor": ("a.gltf", gltf({"count": 10**10}), import_file, TOO_MUCH + "|not glTF"),
    "instances": (
        "a.gltf",
        gltf(WIDE, "data:application/octet-stream;base64," + "A" * 48_000, nodes=30_000),
        import_file,
        TOO_MUCH + "|not glTF|expected 1 to 500",
    ),
    "json": ("a.gltf", "[" * 100_000, import_file, "not glTF"),
}  # fmt: skip
MESHES = {
    "missing vertex": ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"),
    "nan": ("m.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "polygon": ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 2_500_000),
    "declared": ("m.stl", bytes(80) + struct.pack("<I", 2**31) + bytes(50)),
    "claimed": ("m.ply", b"ply\nformat ascii 1.0\nelement vertex 999999999999\nend_header\n"),
    "entities": ("m.dae", b'<!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>'),
}


def refused(path: Path, read: Callable[[Path], Any], message: str) -> None:
    with bounded_by(SMALL), pytest.raises(NeoWorldError, match=message) as caught:
        read(path)
    assert path.name in str(caught.value)
    assert len(str(caught.value)) < 2000
    assert "Traceback" not in str(caught.value)


@pytest.mark.parametrize("name", FILES)
def test_a_hostile_file_is_refused_with_one_message(tmp_path, name):
    file, content, read, message = FILES[name]
    data = content() if callable(content) else content
    (tmp_path / file).write_bytes(data if isinstance(data, bytes) else data.encode())
    refused(tmp_path / file, read, message)


@pytest.mark.parametrize("name", MESHES)
def test_a_hostile_mesh_is_refused_with_one_message(tmp_path, name):
    file, data = MESHES[name]
    (tmp_path / file).write_bytes(data)
    (tmp_path / "a.urdf").write_text(mesh_urdf(file))
    with bounded_by(SMALL), pytest.raises(SpecError) as caught:
        import_file(tmp_path / "a.urdf")
    assert len(str(caught.value)) < 600


BOX_OBJECT = single("box", Box(size=(0.1, 0.1, 0.1)))
SCENE_EDITS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "far up": (lambda s: s["objects"][0].update(z=1e300), "z: .*at most 10 km"),
    "far away": (lambda s: s["objects"][0].update(xy=[0.0, -2e4]), "xy.1: .*at most 10 km"),
    "turned": (lambda s: s["objects"][0].update(yaw=1e200), r"yaw: .*at most 1e\+09"),
    "no rotation": (lambda s: s["objects"][0].update(base_tilt=[0, 0, 0, 0]), "base_tilt: .*zero"),
    "huge rotation": (
        lambda s: s["objects"][0].update(base_tilt=[1e200, 0, 0, 0]),
        r"base_tilt.0: .*at most 1e\+09",
    ),
    "no rotation of a shape": (lambda s: geom_of(s).update(quat=[0, 0, 0, 0]), "quat: .*zero"),
    "huge shape": (lambda s: geom_of(s)["shape"].update(size=[1e300, 1, 1]), "at most 10 km"),
    "infinite mass": (
        lambda s: s["objects"][0]["spec"]["parts"][0].update(mass=float("inf")),
        r"mass: .*at most 1e\+09",
    ),
    "gravity": (lambda s: s.update(gravity=[0, 0, -1e30]), r"gravity.2: .*at most 1e\+09"),
    "CUP and cup": (
        lambda s: s["objects"].append(s["objects"][0] | {"name": "BOX"}),
        "object names must be unique, ignoring case; repeated: BOX, box",
    ),
    "parts p and P": (
        lambda s: s["objects"][0]["spec"].update(parts=[part_of(s, "p"), part_of(s, "P")]),
        "part names must be unique, ignoring case; repeated: P, p",
    ),
    "materials": (
        lambda s: s["objects"][0]["spec"]["materials"].append(
            s["objects"][0]["spec"]["materials"][0] | {"name": "WOOD"}
        ),
        "material names must be unique, ignoring case",
    ),
}  # fmt: skip


def geom_of(scene: dict[str, Any]) -> dict[str, Any]:
    return scene["objects"][0]["spec"]["parts"][0]["geoms"][0]


def part_of(scene: dict[str, Any], name: str) -> dict[str, Any]:
    part = scene["objects"][0]["spec"]["parts"][0]
    return part | {"name": name, "geoms": [geom_of(scene) | {"name": name * 2}]}


@pytest.mark.parametrize("name", SCENE_EDITS)
def test_numbers_and_names_of_a_scene_are_bounded(tmp_path, name):
    """Numbers that formats cannot hold, and files that are one on disks that ignore case."""
    edit, message = SCENE_EDITS[name]
    scene = json.loads(single_object_scene(BOX_OBJECT).to_json())
    edit(scene)
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    refused(tmp_path / "scene.json", read_scene, message)


def crowd(count: int, folder: Path) -> Path:
    """Write a scene of boxes that all overlap, as `model_copy` makes it, without its checks."""
    boxes = tuple(SceneObject(name=f"o{k}", spec=BOX_OBJECT) for k in range(count))
    scene = SceneSpec(objects=boxes[:1]).model_copy(update={"objects": boxes})
    (folder / "scene.json").write_text(scene.to_json())
    return folder / "scene.json"


CROWDS = {
    "too many objects": (501, "500 items"),
    "too many constraints": (128, "more contacts than MuJoCo's memory holds: move overlapping"),
    "ignored contacts": (300, "more contacts than MuJoCo's memory holds: move overlapping"),
}


@pytest.mark.parametrize("name", CROWDS)
def test_a_crowded_scene_is_refused_with_one_message(tmp_path, neoworld, name):
    """Memory that is full makes MuJoCo raise a fatal error, or ignore contacts with a warning."""
    count, message = CROWDS[name]
    code, _, error = neoworld("check", crowd(count, tmp_path), "--quiet")
    assert code == 2 and re.search(message, error), error
    assert len(error.splitlines()[-1]) < 600


SPECIAL = ("pipe", "device", "folder", "circle", "missing")


@pytest.mark.parametrize("kind", SPECIAL)
@pytest.mark.parametrize("read", [json_of, model_of, arrays_of, load_config, import_file])
def test_only_regular_files_are_read(tmp_path, kind, read):
    path = tmp_path / "a.urdf"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind != "missing":
        path.symlink_to("/dev/zero" if kind == "device" else path)
    with pytest.raises(NeoWorldError, match=f"cannot read (config )?{path}"):
        read(path)


OUTSIDE = {
    "URDF mesh": {"a.urdf": mesh_urdf("../secret.obj")},
    "package": {"a.urdf": mesh_urdf("package://x/../../secret.obj")},
    "glTF buffer": {"a.gltf": gltf({"bufferView": 0, "count": 3}, "../secret.bin")},
    "poses": {
        "poses.json": json.dumps(
            {"objects": {"a": {"file": "../secret.obj", "pose": np.eye(4).tolist()}}}
        )
    },
    "include": {"a.xml": '<mujoco><include file="../secret.xml"/></mujoco>'},
    "itself": {"a.xml": '<mujoco><include file="a.xml"/></mujoco>'},
    "link": {"a.urdf": mesh_urdf("link.obj")},
} | {
    f"meshdir {folder!r} in {place}": {
        "a.xml": '<mujoco><include file="mesh.xml"/><include file="dir.xml"/></mujoco>',
        "mesh.xml": mjcf(
            '<geom type="mesh" mesh="m"/>', '<asset><mesh name="m" file="secret.obj"/></asset>'
        )
        if place == "include"
        else f'<mujoco><compiler meshdir="{folder}"/>'
        '<asset><mesh name="m" file="x/../secret.obj"/></asset></mujoco>',
        "dir.xml": f'<mujoco><compiler meshdir="{folder}"/></mujoco>',
    }
    for folder in ("..", "/", "sub/../..")
    for place in ("include", "one file")
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_an_asset_names_no_file_outside_of_its_folder(tmp_path, name):
    home = tmp_path / "home"
    home.mkdir()
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    (tmp_path / "secret.obj").write_text(triangle)
    (tmp_path / "secret.bin").write_bytes(np.zeros(9, np.float32).tobytes())
    (tmp_path / "secret.xml").write_text(mjcf(BALL))
    (home / "link.obj").symlink_to(tmp_path / "secret.obj")
    for file, text in OUTSIDE[name].items():
        (home / file).write_text(text)
    with pytest.raises(SpecError, match=r"outside its folder|includes itself"):
        import_file(home / next(iter(OUTSIDE[name])))


def _allocate(path: Path) -> int:
    return int(np.ones(1 << 30, np.uint8).sum())


def _spin(path: Path) -> None:
    while True:
        pass


def _sleep(path: Path) -> None:
    time.sleep(1000)


def _crash(path: Path) -> None:
    ctypes.string_at(0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (_allocate, "takes over 500 MiB of memory to read; .*files.memory_mib"),
        (_spin, r"takes over 0\.5 s to read; .*files\.timeout_s"),
        (_sleep, r"takes over 0\.5 s to read"),
        (_crash, r"crashes its reader \(status -11\)"),
    ],
)
def test_the_death_of_a_reader_is_one_message_and_the_next_reader_works(
    tmp_path, function, message
):
    with bounded_by(FileOptions(timeout_s=0.5)), pytest.raises(SpecError, match=message):
        call_limited(function, tmp_path / "a")
    assert call_limited(Path.exists, tmp_path) is True


def test_relative_paths_are_those_of_the_caller(tmp_path, monkeypatch):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.urdf").write_text(f'<robot name="{name}"><link name="a">{BOX}</link></robot>')  # fmt: skip  # noqa: E501
        monkeypatch.chdir(tmp_path / name)
        assert import_file(Path("a.urdf")).spec.name == name


def test_files_within_the_bounds_are_read(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
    )
    mesh = '<compiler meshdir="sub"/><asset><mesh name="m" file="m.obj"/></asset>'
    (tmp_path / "a.xml").write_text(mjcf('<geom type="mesh" mesh="m"/>', mesh))
    assert len(import_file(tmp_path / "a.xml").spec.parts) == 1
    (tmp_path / "star.xml").write_text(star(80))
    assert len(import_file(tmp_path / "star.xml").spec.joints) == 80
    (tmp_path / "w.urdf").write_text(f'<robot name="world"><link name="world">{BOX}</link></robot>')
    imported = import_file(tmp_path / "w.urdf")
    assert imported.spec.name == "world_1"
    assert "the object is named world_1 because MuJoCo reserves 'world'" in imported.notes


def test_arrays_and_rows_round_trip(tmp_path):
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "names": np.array(["x", "yz"]),
        "empty": np.zeros((0, 4), np.float32),
        "scalar": np.array(3),
    }
    np.savez_compressed(tmp_path / "a.npz", allow_pickle=False, **arrays)
    read = read_arrays(tmp_path / "a.npz", RunError)
    assert list(read) == list(arrays)
    for name, value in arrays.items():
        np.testing.assert_array_equal(read[name], value)
        assert read[name].dtype == value.dtype


def test_large_photographs_of_phones_are_read_and_those_of_run_folders_refused(tmp_path):
    path, exif = tmp_path / "a.jpg", Image.Exif()
    exif[0x0112] = 6
    gray = np.zeros((9000, 12_000), np.uint8)
    gray[:, 6000:] = 200
    Image.fromarray(gray).save(path, exif=exif)
    photo = load_photo(path, 600)
    assert (photo.original_size, photo.size) == ((9000, 12_000), (450, 600))
    assert photo.rgb[100].max() < 5 and photo.rgb[500].min() > 195
    with pytest.raises(PhotoError, match="a: 5000 x 5000 pixels, 25 megapixels; the limit is 16"):
        with open_image(png(5000, 5000), "a", PhotoError):
            pass


UNBOUNDED = {"np.load", "yaml.safe_load", "yaml.load", "json.load"}


def test_the_library_reads_files_only_by_bounded_readers():
    """Every image states its formats, every text its encoding, and no reader is unbounded."""
    for path in LIBRARY.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            line, function = f"{path}:{node.lineno}", ast.unparse(node.func)
            keywords: set[object] = {keyword.arg for keyword in node.keywords}
            constants = {arg.value for arg in node.args if isinstance(arg, ast.Constant)}
            assert function != "Image.open" or "formats" in keywords, line
            if function.endswith((".write_text", ".read_text")):
                assert {"encoding", "utf-8"} & (keywords | constants), line
            if path.name != "pages.py":  # The pages of options come from the repository itself.
                assert function not in UNBOUNDED, f"{line}: use neoworld_mjx.io"
