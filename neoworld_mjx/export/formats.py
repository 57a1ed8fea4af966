"""The files of a scene or an object in one format, or in those that a simulator wants."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pxr import Sdf, UsdUtils

from ..errors import ExportError
from ..format_names import Format, Simulator
from ..physics.lowering import polyhedron_error
from ..spec import ObjectSpec, SceneSpec, bounds, link_poses, pieces, world_poses
from ..spec.convex import box_around
from .isaac_layer import isaac_text
from .meshes import mesh_files
from .newton_layer import newton_text
from .textures import is_textured, texture_files
from .write_directives import directives_text, package_text
from .write_drives import drives_text
from .write_glb import glb_bytes
from .write_mjcf import mjcf_text
from .write_scene_usd import scene_usd_layer
from .write_sdf import sdf_text
from .write_urdf import srdf_text, urdf_text
from .write_usd import usd_layer

Described = SceneSpec | ObjectSpec
LAYERS: dict[Simulator, Callable[[Described, str], str]] = {
    "newton": newton_text, "isaac": isaac_text,
}  # fmt: skip
"""Layers that say in a simulator's words what MJCF says to MuJoCo."""


def format_files(
    described: Described, kind: Format, *, mjx: bool = False, floor: bool = False
) -> dict[str, bytes]:
    """Return the files of a scene or an object in a format: path in its folder, and content.

    A scene's objects are in objects/<name>/.

    Args:
        described: the scene or object.
        kind: the format; USD is written in its binary form.
        mjx: whether MJCF has only colliders that MJX knows.
        floor: whether MJCF has a floor without end below everything.
    """
    return _Writer(described, mjx, floor).files(kind)


def lost(described: Described, kind: Format) -> list[str]:
    """List, in words, what a format does not hold of a scene or an object."""
    joints = [(owner, joint) for owner, spec in _objects(described) for joint in spec.joints]
    result = []

    def tell(what: str, names: list[str]) -> None:
        if names:
            result.append(f"{what}: {', '.join(names)}")

    def with_(*fields: str) -> list[str]:
        return [
            f"{owner}.{joint.name}"
            for owner, joint in joints
            if any(getattr(joint, field) for field in fields)
        ]

    def balls() -> list[str]:
        return [f"{owner}.{joint.name}" for owner, joint in joints if joint.type == "ball"]

    if kind == "glb":
        return ["colliders, joints, masses and friction"]
    if kind in ("urdf", "sdf"):
        tell(
            "textures, of which the colours are left",
            sorted(
                f"{owner}.{geom.material}"
                for owner, spec in _objects(described)
                for geom in {g.material: g for p in spec.parts for g in p.geoms}.values()
                if is_textured(spec, geom)
            ),
        )
    if kind == "urdf":
        tell("stiffness and armature of joints", with_("stiffness", "armature"))
        tell("balls are three hinges", balls())
        result.append("metallic and roughness of materials")
        result.append("colliders of what moves are drawn in by 0.5 mm, ellipsoids are meshes")
    if kind == "sdf":
        tell("armature of joints", with_("armature"))
        if isinstance(described, SceneSpec):
            moved = [item.name for item in described.objects if any(item.joint_state.values())]
            tell("joints are at 0", moved)
    if kind == "mjcf":
        tell("velocity limits", with_("velocity"))
    if kind in ("usd", "usdz"):
        tell("the twist of balls is not limited, their damping is our own attribute", balls())
        result.append("ellipsoids collide as meshes")
    return result


def collider_error(described: Described) -> float:
    """Return how far [m] colliders for MJX lie beside the true surfaces, at most."""
    return max(
        (
            polyhedron_error(piece.kind, piece.size)
            for _, spec in _objects(described)
            for part in spec.parts
            for _, piece, _ in pieces(part)
        ),
        default=0.0,
    )


def write_formats(
    described: Described,
    out: Path,
    kinds: Sequence[Format],
    *,
    simulator: Simulator | None = None,
    floor: bool = False,
) -> list[str]:
    """Write formats into a folder and return the paths, relative to it.

    Args:
        described: the scene or object.
        out: the folder.
        kinds: the formats.
        simulator: whom the files are for: for mjx, MJCF has only colliders that it knows; for
            newton and isaac a layer of that name lies over USD: newton.usda, isaac.usda.
        floor: whether MJCF has a floor without end below everything.

    Raises:
        ExportError: a file cannot be written.
    """
    files: dict[str, bytes] = {}
    writer = _Writer(described, simulator == "mjx", floor)
    for kind in kinds:
        files |= writer.files(kind)
    if simulator in LAYERS and "usd" in kinds:
        text = LAYERS[simulator](described, f"{_stem(described)}.usdc")
        files[f"{simulator}.usda"] = text.encode()
    _write(files, out)
    return sorted(files)


def _write(files: dict[str, bytes], out: Path) -> None:
    for path, content in files.items():
        target = out / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        except OSError as error:
            raise ExportError(f"cannot write {target}: {error.strerror}") from None


def _objects(described: Described) -> list[tuple[str, ObjectSpec]]:
    if isinstance(described, ObjectSpec):
        return [(described.name, described)]
    return [(item.name, item.spec) for item in described.objects]


def _stem(described: Described) -> str:
    return "object" if isinstance(described, ObjectSpec) else "scene"


def _folder(described: Described, name: str) -> str:
    return "" if isinstance(described, ObjectSpec) else f"objects/{name}/"


@dataclass(frozen=True)
class _Writer:
    """Writes formats of one scene or object; what several of them share is made once."""

    described: Described
    mjx: bool
    floor: bool

    def files(self, kind: Format) -> dict[str, bytes]:
        makers: dict[Format, Callable[[], dict[str, bytes]]] = {
            "mjcf": self._mjcf, "urdf": self._urdf, "usd": lambda: self._usd,
            "usdz": self._usdz, "sdf": self._sdf, "glb": self._glb,
        }  # fmt: skip
        return makers[kind]()

    @cached_property
    def _meshes(self) -> dict[str, bytes]:
        return {
            f"{_folder(self.described, name)}{path}": text.encode()
            for name, spec in _objects(self.described)
            for path, text in mesh_files(spec).items()
        }

    @cached_property
    def _textures(self) -> dict[str, bytes]:
        return {
            f"{_folder(self.described, name)}{path}": content
            for name, spec in _objects(self.described)
            for path, content in texture_files(spec).items()
        }

    @cached_property
    def _usd(self) -> dict[str, bytes]:
        described = self.described
        files = {
            f"{_folder(described, name)}object.usdc": _binary(usd_layer(spec))
            for name, spec in _objects(described)
        }
        files |= self._textures
        if isinstance(described, SceneSpec):
            files["scene.usdc"] = _binary(scene_usd_layer(described, "usdc"))
        return files

    def _mjcf(self) -> dict[str, bytes]:
        described, file = self.described, f"{_stem(self.described)}.xml"
        target = "mjx" if self.mjx else "mujoco"
        floor = _lowest(described) if self.floor else None
        text = mjcf_text(described, target=target, floor=floor)
        drives = drives_text(described, file)
        files = {file: text.encode(), **self._meshes, **self._textures}
        return files if drives is None else {**files, "drives.xml": drives.encode()}

    def _urdf(self) -> dict[str, bytes]:
        files = dict(self._meshes)
        for name, spec in _objects(self.described):
            home = _folder(self.described, name)
            files[f"{home}object.urdf"] = urdf_text(spec).encode()
            files[f"{home}object.srdf"] = srdf_text(spec).encode()
        if isinstance(self.described, SceneSpec):
            files["scene.dmd.yaml"] = directives_text(self.described).encode()
            files["package.xml"] = package_text(self.described).encode()
        return files

    def _sdf(self) -> dict[str, bytes]:
        return {f"{_stem(self.described)}.sdf": sdf_text(self.described).encode(), **self._meshes}

    def _glb(self) -> dict[str, bytes]:
        described = self.described
        files = {f"{_stem(described)}.glb": glb_bytes(described)}
        if isinstance(described, SceneSpec):
            files |= {f"objects/{n}/object.glb": glb_bytes(s) for n, s in _objects(described)}
        return files

    def _usdz(self) -> dict[str, bytes]:
        stem = _stem(self.described)
        with tempfile.TemporaryDirectory() as folder:
            home = Path(folder)
            _write(self._usd, home)
            package = home / f"{stem}.usdz"
            if not UsdUtils.CreateNewUsdzPackage(str(home / f"{stem}.usdc"), str(package)):
                raise ExportError(f"USD cannot pack {package.name}")
            return {package.name: package.read_bytes()}


def _lowest(described: Described) -> float:
    """Return the height of the lowest collider [m]."""
    if isinstance(described, ObjectSpec):
        return float(bounds(described)[0][2])
    lows = []
    poses = world_poses(described)
    for item in described.objects:
        moved = link_poses(item.spec, item.joint_state)
        for part in item.spec.parts:
            for _, piece, at in pieces(part):
                place = poses[item.name].then(moved[part.name]).then(at)
                lows.append(float(box_around(piece, place)[0][2]))
    return min(lows)


def _binary(layer: Sdf.Layer) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "layer.usdc"
        if not layer.Export(str(path)):
            raise ExportError(f"USD cannot write {path}")
        return path.read_bytes()
