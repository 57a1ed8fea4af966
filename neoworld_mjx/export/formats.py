"""Files of a scene or an object: those of a run folder, and those of `neoworld export`."""

import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pxr import Sdf, Tf, UsdUtils

from ..errors import ExportError
from ..io.files import write_inside
from ..names import Format, Simulator
from ..physics.lowering import polyhedron_error
from ..spec import (
    JointSpec,
    Material,
    ObjectSpec,
    SceneSpec,
    bounds,
    pieces,
    world_bounds,
    world_poses,
)
from .write_glb import glb_bytes, has_texture, mesh_files, texture_files
from .write_mjcf import mjcf_text
from .write_scene_usd import scene_usd_layer
from .write_sdf import sdf_text
from .write_urdf import urdf_text
from .write_usd import usd_layer

SceneOrObject = SceneSpec | ObjectSpec
RUN_FORMATS: tuple[Format, ...] = ("mjcf", "urdf", "usd", "sdf")
"""Formats of a run folder, which contains USD as text."""
Holds = Callable[[SceneOrObject], bool]


def _shapes(*types: str) -> Holds:
    return lambda d: any(
        geom.shape.type in types and geom.role != "visual"
        for _, spec in _objects(d)
        for part in spec.parts
        for geom in part.geoms
    )


def _joints(holds: Callable[[JointSpec], object]) -> Holds:
    return lambda d: any(holds(joint) for _, spec in _objects(d) for joint in spec.joints)


def _materials(holds: Callable[[Material], object]) -> Holds:
    return lambda d: any(holds(m) for _, spec in _objects(d) for m in spec.materials)


_ball = _joints(lambda j: j.type == "ball")
_moving = _joints(lambda j: j.type != "fixed")
_textured = _materials(has_texture)
_LOSSES: dict[Format, tuple[tuple[str, Holds], ...]] = {
    "mjcf": (("velocity limits of joints", _joints(lambda j: j.velocity is not None)),),
    "urdf": (
        ("textures", _textured),
        ("metallic and roughness of materials", lambda _: True),
        ("stiffness and armature of joints", _joints(lambda j: j.stiffness or j.armature)),
        ("ball joints, written as three hinges", _ball),
        (
            "friction of single colliders; each link states the mean of its colliders",
            lambda d: any(len({m.friction for m in spec.materials}) > 1 for _, spec in _objects(d)),
        ),
        (
            "exact colliders: those of moving parts shrink by 0.5 mm on each side",
            _moving,
        ),
        ("ellipsoid colliders, written as meshes", _shapes("ellipsoid")),
        ("poses of objects; scene.json has them", lambda d: isinstance(d, SceneSpec)),
    ),
    "sdf": (
        ("textures", _textured),
        ("armature of joints", _joints(lambda j: j.armature)),
        (
            "joint positions; all joints are at zero",
            lambda d: isinstance(d, SceneSpec) and any(item.joint_state for item in d.objects),
        ),
    ),
    "usd": (
        ("ellipsoid colliders, written as meshes", _shapes("ellipsoid")),
        ("limits on the twist of ball joints; their damping is a custom attribute", _ball),
    ),
    "glb": (("joints, colliders, densities and friction", lambda _: True),),
}
"""Data that a format cannot store, with a function that returns whether a scene has such data."""


def losses(kind: Format, described: SceneOrObject) -> list[str]:
    """Return the data of a scene or an object that a format cannot store."""
    return [text for text, holds in _LOSSES["usd" if kind == "usdz" else kind] if holds(described)]


def export_object(spec: ObjectSpec, out: Path) -> None:
    """Write object.urdf, .sdf, .usda and .xml, meshes/ and textures/ into a folder.

    Existing files are replaced. The same object always gives the same bytes.

    Raises:
        ExportError: a file cannot be written.
    """
    _write(object_files(spec), out)


def export_scene(scene: SceneSpec, out: Path) -> None:
    """Write scene.json, .xml, .usda, .sdf and objects/<name>/ into a folder.

    scene.xml refers to the meshes and textures of the objects, and scene.usda refers to the USD
    files of the objects. Objects are written at their final size.

    Raises:
        ExportError: a file cannot be written.
    """
    _write(scene_files(scene), out)


def object_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the contents of an object's files, by path relative to the object's folder."""
    return _files(spec, RUN_FORMATS, usd="usda")


def scene_files(scene: SceneSpec) -> dict[str, bytes]:
    """Return the contents of the files of a scene and its objects, by relative path."""
    return {"scene.json": scene.to_json().encode()} | _files(scene, RUN_FORMATS, usd="usda")


def write_formats(
    described: SceneOrObject,
    out: Path,
    kinds: Sequence[Format],
    *,
    simulator: Simulator | None = None,
    floor: bool = False,
) -> list[str]:
    """Write a scene or an object in several formats; return paths relative to the folder.

    Args:
        described: the scene or object.
        out: the folder.
        kinds: the formats.
        simulator: simulator that will load the files; "mjx" restricts MJCF to colliders that MJX
            supports.
        floor: if True, MJCF contains an infinite floor at z = 0, or lower if a free object reaches
            lower.

    Raises:
        ExportError: a file cannot be written.
    """
    files = _files(described, kinds, mjx=simulator == "mjx", floor=floor)
    _write(files, out)
    return sorted(files)


def collider_error(described: SceneOrObject) -> float:
    """Return the largest distance between a collider for MJX and the surface it replaces [m]."""
    return max(
        (
            polyhedron_error(piece.kind, piece.size)
            for _, spec in _objects(described)
            for part in spec.parts
            for _, piece, _ in pieces(part)
        ),
        default=0.0,
    )


def _files(
    described: SceneOrObject,
    kinds: Collection[Format],
    *,
    usd: str = "usdc",
    mjx: bool = False,
    floor: bool = False,
) -> dict[str, bytes]:
    """Return the files of a scene or an object; each object of a scene has a folder.

    Args:
        described: the scene or object.
        kinds: the formats.
        usd: suffix of USD files: "usdc" (binary) or "usda" (text).
        mjx: if True, MJCF contains only colliders that MJX supports.
        floor: if True, MJCF contains a floor.
    """
    stem, files = _stem(described), dict[str, bytes]()
    if isinstance(described, SceneSpec):
        for item in described.objects:
            inner = _files(item.spec, [k for k in kinds if k != "usdz"], usd=usd, mjx=mjx)
            files |= {f"objects/{item.name}/{path}": content for path, content in inner.items()}
    else:
        if {"mjcf", "urdf", "sdf"} & set(kinds):
            files |= {path: text.encode() for path, text in mesh_files(described).items()}
        if {"mjcf", "usd"} & set(kinds):
            files |= texture_files(described)
        if "urdf" in kinds:
            files["object.urdf"] = urdf_text(described).encode()
    if "mjcf" in kinds:
        height = _floor_height(described) if floor else None
        text = mjcf_text(described, target="mjx" if mjx else "mujoco", floor=height)
        files[f"{stem}.xml"] = text.encode()
    if "usd" in kinds:
        layer = usd_layer(described) if isinstance(described, ObjectSpec) else (
            scene_usd_layer(described, usd)
        )  # fmt: skip
        files[f"{stem}.{usd}"] = (
            layer.ExportToString().encode() if usd == "usda" else _binary(layer)
        )
    if "usdz" in kinds:
        files[f"{stem}.usdz"] = _package(described)
    if "sdf" in kinds:
        files[f"{stem}.sdf"] = sdf_text(described).encode()
    if "glb" in kinds:
        files[f"{stem}.glb"] = glb_bytes(described)
    return files


def _write(files: dict[str, bytes], out: Path) -> None:
    """Write files, given by paths relative to a folder, without following symbolic links.

    Raises:
        ExportError: a file cannot be written.
    """
    for path, content in files.items():
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_inside(out, path, content, sync=False)
        except OSError as error:
            raise ExportError(f"cannot write {out / path}: {error.strerror}") from None


def _objects(described: SceneOrObject) -> list[tuple[str, ObjectSpec]]:
    if isinstance(described, ObjectSpec):
        return [(described.name, described)]
    return [(item.name, item.spec) for item in described.objects]


def _stem(described: SceneOrObject) -> str:
    return "object" if isinstance(described, ObjectSpec) else "scene"


def _package(described: SceneOrObject) -> bytes:
    """Return a USDZ package of a scene or an object, with its textures."""
    stem = _stem(described)
    with _temporary_folder() as root:
        _write(_files(described, ["usd"]), root)
        package = root / f"{stem}.usdz"
        if not UsdUtils.CreateNewUsdzPackage(str(root / f"{stem}.usdc"), str(package)):
            raise ExportError(f"USD cannot pack {package.name}")
        return package.read_bytes()


def _floor_height(described: SceneOrObject) -> float:
    """Return 0, or the height of the lowest collider of a free object if it is lower [m]."""
    if isinstance(described, ObjectSpec):
        return float(bounds(described)[0][2])
    poses = world_poses(described)
    lows = [
        world_bounds(item, poses[item.name])[0][2] for item in described.objects if not item.static
    ]
    return float(min([0.0, *lows]))


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    """Create a folder in which USD writes.

    Raises:
        ExportError: USD cannot write there, such as to a full disk.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except Tf.ErrorException as error:
        reason = str(error).strip().strip("'").rpartition(": ")[2]
        raise ExportError(
            f"USD cannot write to {tempfile.gettempdir()}: {reason}; free some space, or set TMPDIR"
        ) from None


def _binary(layer: Sdf.Layer) -> bytes:
    with _temporary_folder() as folder:
        path = folder / "layer.usdc"
        if not layer.Export(str(path)):
            raise ExportError(f"USD cannot write {path}")
        return path.read_bytes()
