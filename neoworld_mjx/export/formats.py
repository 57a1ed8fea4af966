"""Files of a scene or an object in one format, or for one simulator."""

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
from .write_drives import drives_text
from .write_files import encoded, write_all
from .write_glb import glb_bytes
from .write_mjcf import mjcf_text
from .write_scene_usd import scene_usd_layer
from .write_sdf import sdf_text
from .write_urdf import srdf_text, urdf_text
from .write_usd import usd_layer

SceneOrObject = SceneSpec | ObjectSpec
LAYERS: dict[Simulator, Callable[[SceneOrObject, str], str]] = {
    "newton": newton_text, "isaac": isaac_text,
}  # fmt: skip
"""Functions that return a USD layer with the settings of a simulator, by simulator."""


def unsupported_data(described: SceneOrObject, kind: Format) -> list[str]:
    """Return descriptions of the data of a scene or an object that a format cannot store."""
    objects = _objects(described)
    joints = [(f"{owner}.{joint.name}", joint) for owner, spec in objects for joint in spec.joints]
    balls = [name for name, joint in joints if joint.type == "ball"]

    def with_field(*fields: str) -> list[str]:
        return [name for name, joint in joints if any(getattr(joint, field) for field in fields)]

    textured = sorted(
        {
            f"{owner}.{geom.material}"
            for owner, spec in objects
            for part in spec.parts
            for geom in part.geoms
            if is_textured(spec, geom)
        }
    )
    displaced = []
    if isinstance(described, SceneSpec):
        displaced = [item.name for item in described.objects if any(item.joint_state.values())]
    textures = ("textures, replaced by plain colors", textured)
    specific: dict[Format, list[tuple[str, list[str]]]] = {
        "urdf": [
            textures,
            ("stiffness and armature of joints", with_field("stiffness", "armature")),
            ("ball joints, written as three hinges", balls),
        ],
        "sdf": [
            textures,
            ("armature of joints", with_field("armature")),
            ("joint positions; all joints are at zero", displaced),
        ],
        "mjcf": [("velocity limits", with_field("velocity"))],
        "usd": [
            (
                "limits on the twist of ball joints; their damping is a custom attribute",
                balls,
            )
        ],
    }
    general: dict[Format, list[str]] = {
        "glb": [
            "joints; colliders, densities and friction for readers that ignore the file's extras"
        ],
        "urdf": [
            "metallic and roughness of materials",
            "friction of single colliders; each link states the mean of its colliders",
            "exact colliders: those of moving parts shrink by 0.5 mm on each side, and ellipsoids "
            "become meshes",
        ],
        "usd": ["ellipsoid colliders, written as meshes"],
    }
    stored: Format = "usd" if kind == "usdz" else kind
    listed = [
        f"{content}: {', '.join(names)}" for content, names in specific.get(stored, []) if names
    ]
    return [*listed, *general.get(stored, [])]


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
        simulator: simulator that will load the files: "mjx" restricts MJCF to colliders that MJX
            supports; "newton" and "isaac" add a USD layer, newton.usda or isaac.usda.
        floor: if True, MJCF contains an infinite floor at the height of the lowest collider.

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
    write_all(files, out)
    return sorted(files)


def _objects(described: SceneOrObject) -> list[tuple[str, ObjectSpec]]:
    if isinstance(described, ObjectSpec):
        return [(described.name, described)]
    return [(item.name, item.spec) for item in described.objects]


def _stem(described: SceneOrObject) -> str:
    return "object" if isinstance(described, ObjectSpec) else "scene"


@dataclass(frozen=True)
class _Writer:
    """Writer of one scene or object, which builds files that several formats share only once."""

    described: SceneOrObject
    mjx: bool
    floor: bool

    def files(self, kind: Format) -> dict[str, bytes]:
        """Return the files of a format."""
        writers: dict[Format, Callable[[], dict[str, bytes]]] = {
            "mjcf": self._mjcf, "urdf": self._urdf, "usd": lambda: self._usd,
            "usdz": self._usdz, "sdf": self._sdf, "glb": self._glb,
        }  # fmt: skip
        return writers[kind]()

    @cached_property
    def _meshes(self) -> dict[str, bytes]:
        return self._of_objects(lambda spec: encoded({**mesh_files(spec)}))

    @cached_property
    def _textures(self) -> dict[str, bytes]:
        return self._of_objects(texture_files)

    def _of_objects(self, files_of: Callable[[ObjectSpec], dict[str, bytes]]) -> dict[str, bytes]:
        """Return the files of all objects by path; in a scene, each object has a folder."""
        single = isinstance(self.described, ObjectSpec)
        return {
            f"{'' if single else f'objects/{name}/'}{path}": content
            for name, spec in _objects(self.described)
            for path, content in files_of(spec).items()
        }

    @cached_property
    def _usd(self) -> dict[str, bytes]:
        files = self._of_objects(lambda spec: {"object.usdc": _binary(usd_layer(spec))})
        files |= self._textures
        if isinstance(self.described, SceneSpec):
            files["scene.usdc"] = _binary(scene_usd_layer(self.described, "usdc"))
        return files

    def _mjcf(self) -> dict[str, bytes]:
        described, file = self.described, f"{_stem(self.described)}.xml"
        target = "mjx" if self.mjx else "mujoco"
        floor = _lowest(described) if self.floor else None
        text = mjcf_text(described, target=target, floor=floor)
        return {
            file: text.encode(),
            **self._meshes,
            **self._textures,
            **encoded({"drives.xml": drives_text(described, file)}),
        }

    def _urdf(self) -> dict[str, bytes]:
        return self._meshes | self._of_objects(
            lambda spec: encoded({"object.urdf": urdf_text(spec), "object.srdf": srdf_text(spec)})
        )

    def _sdf(self) -> dict[str, bytes]:
        return {f"{_stem(self.described)}.sdf": sdf_text(self.described).encode(), **self._meshes}

    def _glb(self) -> dict[str, bytes]:
        files = {f"{_stem(self.described)}.glb": glb_bytes(self.described)}
        if isinstance(self.described, SceneSpec):
            files |= self._of_objects(lambda spec: {"object.glb": glb_bytes(spec)})
        return files

    def _usdz(self) -> dict[str, bytes]:
        stem = _stem(self.described)
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            write_all(self._usd, root)
            package = root / f"{stem}.usdz"
            if not UsdUtils.CreateNewUsdzPackage(str(root / f"{stem}.usdc"), str(package)):
                raise ExportError(f"USD cannot pack {package.name}")
            return {package.name: package.read_bytes()}


def _lowest(described: SceneOrObject) -> float:
    """Return the height of the lowest point of all colliders [m]."""
    if isinstance(described, ObjectSpec):
        return float(bounds(described)[0][2])
    lows = []
    poses = world_poses(described)
    for item in described.objects:
        part_poses = link_poses(item.spec, item.joint_state)
        for part in item.spec.parts:
            for _, piece, local in pieces(part):
                piece_pose = poses[item.name].then(part_poses[part.name]).then(local)
                lows.append(float(box_around(piece, piece_pose)[0][2]))
    return min(lows)


def _binary(layer: Sdf.Layer) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "layer.usdc"
        if not layer.Export(str(path)):
            raise ExportError(f"USD cannot write {path}")
        return path.read_bytes()
