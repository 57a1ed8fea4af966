"""Script that runs one program in Blender, and writes the resulting scene as JSON.

`blender_process` runs this script with the Python interpreter of Blender's environment. Standard
input is the program's text. The arguments are the limits and the file descriptor for the output.
The script does not import this package. The output is as untrusted as the program.
"""

import base64
import importlib
import importlib.util
import json
import os
import sys
import sysconfig
import traceback
from pathlib import Path
from typing import Any

PROGRAM = "<program.py>"
UNAVAILABLE = 77
"""Exit code if this machine cannot confine a process."""
_SYSTEM = ("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/etc/ld.so.cache",
           "/dev/null", "/dev/urandom", "/sys/devices/system/cpu")  # fmt: skip
_DYNAMICS = (
    *("damping", "friction", "stiffness", "effort", "velocity"),
    *("swing", "multiplier", "offset"),
)
_WORDS = ("parent", "child", "mimic", "after")
_GREY = 0.8
"""Base color of a new material in Blender."""


def main() -> int:
    """Confine this process, run the program, write the scene, and return the exit status."""
    memory_mib, cpu_s, file_mib, descriptor = (int(value) for value in sys.argv[1:5])
    confinement = _load_sibling("confinement")
    software = {sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()}
    try:
        confinement.confine(memory_mib, cpu_s, file_mib, [*_SYSTEM, *sorted(software)])
    except confinement.Unavailable as error:
        sys.stderr.write(f"missing: {error}\n")
        return UNAVAILABLE
    text = sys.stdin.read()
    # Blender writes warnings to standard output, so descriptor 1 is redirected to standard error.
    printed = os.fdopen(os.dup(1), "w", errors="replace")
    os.dup2(2, 1)
    bpy: Any = importlib.import_module("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    confinement.end_threads()
    sys.stdout = printed
    scene = _run(text, bpy)
    with os.fdopen(descriptor, "w") as stream:
        json.dump(scene, stream)
    printed.flush()
    return 0


def _load_sibling(name: str) -> Any:
    path = Path(__file__).with_name(f"{name}.py")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _run(text: str, bpy: Any) -> dict[str, Any]:
    """Run the program, and return a description of the resulting scene or of the error."""
    try:
        exec(compile(text, PROGRAM, "exec"), {"__name__": "__main__", "__file__": PROGRAM})
    except SyntaxError as error:
        return _error(error, error.lineno, error.offset, syntax=True)
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == PROGRAM]
        return _error(error, lines[-1] if lines else None)
    try:
        return _scene(bpy)
    except Exception as error:
        return _error(error, None)


def _error(
    error: BaseException, line: int | None, column: int | None = None, *, syntax: bool = False
) -> dict:
    kind = "SyntaxError" if syntax else type(error).__name__
    return {
        "error": {"type": kind[:60], "message": str(error)[:600], "line": line, "column": column}
    }


def _scene(bpy: Any) -> dict[str, Any]:
    """Return the shapes, joints and sites of the current scene, in world coordinates."""
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    shapes, joints, sites, materials = [], [], [], {}
    for obj in scene.objects:
        if obj.type == "EMPTY":
            if "joint" in obj:
                joints.append(_joint(obj))
            elif "site" in obj:
                place = [float(v) for v in obj.matrix_world.translation]
                sites.append({"name": obj.name, "part": str(obj["site"]), "at": place})
        elif obj.type in ("MESH", "CURVE", "SURFACE", "FONT", "META") and not obj.hide_render:
            shape = _shape(obj, graph, materials)
            if shape is not None:
                shapes.append(shape)
    return {
        "name": str(scene.get("object", "")),
        "label": str(scene.get("label", "")),
        "materials": list(materials.values()),
        "shapes": shapes,
        "joints": joints,
        "sites": sites,
    }


def _shape(obj: Any, graph: Any, materials: dict[str, Any]) -> dict[str, Any] | None:
    """Return an object's triangles, after all modifiers, and properties; None without triangles."""
    np: Any = importlib.import_module("numpy")
    evaluated = obj.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    count, triangles = len(mesh.vertices), len(mesh.loop_triangles)
    if count < 3 or triangles < 1:
        return None
    vertices, faces = np.empty(3 * count, np.float32), np.empty(3 * triangles, np.int32)
    slots = np.empty(triangles, np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", faces)
    mesh.loop_triangles.foreach_get("material_index", slots)
    world = np.array(obj.matrix_world, float)
    vertices = vertices.reshape(-1, 3).astype(float) @ world[:3, :3].T + world[:3, 3]
    faces = faces.reshape(-1, 3)
    if np.linalg.det(world[:3, :3]) < 0:
        faces = faces[:, ::-1]
    names = []
    for slot in evaluated.material_slots:
        material = slot.material
        names.append("" if material is None else material.name)
        if material is not None and material.name not in materials:
            materials[material.name] = _material(material)
    mass = obj.get("mass")
    return {
        "name": obj.name,
        "part": str(obj.get("part", obj.name)),
        "role": str(obj.get("role", "both")),
        "convex": bool(obj.get("convex", False)),
        "mass": None if mass is None else float(mass),
        "materials": names,
        "vertices": _packed(np.round(vertices, 7), "<f8"),
        "faces": _packed(faces, "<i4"),
        "slots": _packed(slots, "<i4"),
    }


def _packed(values: Any, kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


def _material(material: Any) -> dict[str, Any]:
    """Return a material's fields: the custom properties, or else values of the Principled BSDF."""
    fields: dict[str, Any] = {"name": material.name}
    tree = material.node_tree
    nodes = [] if tree is None else [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"]
    if nodes:
        inputs = nodes[0].inputs
        base = [float(v) for v in inputs["Base Color"].default_value]
        if any(abs(value - _GREY) > 1e-3 for value in base[:3]):
            fields["rgb"] = [_srgb(value) for value in base[:3]]
        for key, default in (("Metallic", 0.0), ("Roughness", 0.5), ("Alpha", 1.0)):
            value = float(inputs[key].default_value)
            if abs(value - default) > 1e-3:
                fields[key.lower()] = value
    for key in ("density", "friction", "alpha", "metallic", "roughness", "step"):
        if key in material:
            fields[key] = float(material[key])
    for key in ("rgb", "rgb2"):
        if key in material:
            fields[key] = [float(v) for v in material[key]][:3]
    for key in ("like", "pattern", "along"):
        if key in material:
            fields[key] = str(material[key])
    return fields


def _srgb(value: float) -> float:
    """Convert a linear color value to sRGB, clipped to 0 to 1."""
    value = min(max(value, 0.0), 1.0)
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


def _joint(obj: Any) -> dict[str, Any]:
    """Return the joint of an empty; the default axis is the z axis of the empty."""
    world = obj.matrix_world
    fields: dict[str, Any] = {
        "name": obj.name,
        "type": str(obj["joint"]),
        "at": [float(v) for v in world.translation],
        "axis": _direction(obj["axis"]) if "axis" in obj else [float(v) for v in world.col[2]][:3],
    }
    if "range" in obj:
        fields["range"] = [float(v) for v in obj["range"]][:3]
    if "opens" in obj:
        fields["opens"] = _direction(obj["opens"])
    fields |= {key: float(obj[key]) for key in _DYNAMICS if key in obj}
    return fields | {key: str(obj[key]) for key in _WORDS if key in obj}


def _direction(value: Any) -> Any:
    return value[:20] if isinstance(value, str) else [float(v) for v in value][:4]


if __name__ == "__main__":
    sys.exit(main())
