"""Tables of a report: parse, scene, agreement with the photograph, joints, penetrations."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

from .formatting import mm, progress_of, read_json, size_cm, support_of
from .page import elements
from .pictures import picture


def parse_section(folder: Path, tree: dict[str, Any]) -> Markup:
    """Return the section with the nodes of tree.json and the picture of their boxes."""
    nodes = tree.get("nodes")
    if not nodes:
        return elements.section("Parse", elements.missing("No tree.json yet."))
    rows = []
    for node in nodes:
        flags = [
            "environment" if node.get("environment") else "",
            "fixed" if node.get("fixed_base") else "",
            "occluded" if node.get("occluded") else "",
            *(f"{a['part']} {a['type']} {100 * a['opening']:.0f} %" for a in node["articulation"]),
        ]
        link = f" ({node['parent_link']})" if node.get("parent_link") else ""
        rows.append(
            [
                node["name"],
                node["label"],
                support_of(node) + link,
                size_cm(node["box3d"]["size"]),
                f"{math.degrees(node['box3d'].get('yaw', 0.0)):.0f}",
                ", ".join(flag for flag in flags if flag),
            ]
        )
    camera = tree["camera"]
    caption = (
        f"Camera {camera['height']:.2f} m high, pitched down "
        f"{math.degrees(camera['pitch']):.1f}°, vertical field of view "
        f"{math.degrees(camera['fovy']):.1f}°."
    )
    heads = ["object", "label", "support", "#size, cm", "#yaw, deg", "notes"]
    boxes = elements.div("pictures", picture(folder / "pictures" / "parse.png", caption))
    return elements.section("Parse", elements.div("narrow", boxes), elements.table(heads, rows))


def scene_section(scene: dict[str, Any]) -> Markup:
    """Return the section with the poses in scene.json and the size residuals after rescaling."""
    if not scene.get("objects"):
        return elements.section("Scene", elements.missing("No scene.json yet."))
    rows = []
    for obj in scene["objects"]:
        residual = obj.get("scale_residual")
        x, y = obj["xy"]
        rows.append(
            [
                obj["name"],
                support_of(obj),
                f"{1000 * x:.1f}, {1000 * y:.1f}, {1000 * obj.get('z', 0.0):.1f}",
                f"{math.degrees(obj.get('yaw', 0.0)):.1f}",
                " / ".join(f"{100 * v:+.0f}" for v in residual) if residual else "",
                "static" if obj.get("environment") or obj.get("fixed_base") else "movable",
            ]
        )
    heads = [
        *("object", "support", "#x, y, z in parent, mm", "#yaw, deg"),
        *("#size residual x/y/z, %", ""),
    ]
    note = "Size residual: difference from the parsed box, after isotropic rescaling."
    return elements.section("Scene", elements.table(heads, rows), elements.paragraph(note, "dim"))


def agreement(run: dict[str, Any]) -> Markup:
    """Return the section with the overlap of each object's visible and parsed box in each step."""
    title = "Agreement with the photograph"
    measured = run["metrics"].get("box_iou")
    if not measured or not measured["objects"]:
        return elements.section(
            title, elements.missing(f"Measured after refine; {progress_of(run)}.")
        )
    steps = ("parsed", "composed", "refined")
    objects = sorted(measured["objects"].items(), key=lambda item: item[1]["refined"] or 0.0)
    rows = [
        [name, *("" if values[step] is None else f"{values[step]:.2f}" for step in steps)]
        for name, values in [("mean", measured), *objects]
    ]
    note = (
        "Intersection over union of the box around the visible pixels and the parsed 2D box, "
        "lowest first. Parsed cuboid: projection of the parsed 3D box, without occlusion."
    )
    heads = ["object", "#parsed cuboid", "#composed", "#refined"]
    return elements.section(title, elements.table(heads, rows), elements.paragraph(note, "dim"))


def joints(folder: Path, scene: dict[str, Any]) -> Markup:
    """Return the section with the joints of all objects, from scene.json or each spec.json."""
    objects: list[tuple[str, dict[str, Any], dict[str, float]]] = [
        (obj["name"], obj["spec"], obj.get("joint_state", {})) for obj in scene.get("objects", [])
    ]
    if not objects:
        files = sorted((folder / "objects").glob("*/spec.json"))
        objects = [(file.parent.name, read_json(file) or {}, {}) for file in files]
    rows = [
        [name, *_joint_cells(joint, state)]
        for name, spec, state in objects
        for joint in spec.get("joints", [])
        if joint["type"] != "fixed"
    ]
    if not rows:
        note = "No object has a joint." if objects else "No objects yet."
        return elements.section("Joints", elements.missing(note))
    heads = ["object", "joint", "type", "links", "axis", "#range", "#now", "#damping, SI"]
    return elements.section("Joints", elements.table(heads, rows))


def _joint_cells(joint: dict[str, Any], state: dict[str, float]) -> list[str]:
    """Return the cells of a joint that follow the object's name."""
    unit, factor = ("mm", 1000.0) if joint["type"] == "prismatic" else ("°", 180 / math.pi)
    ball = joint["type"] == "ball"
    unlimited = joint["type"] == "continuous" or (ball and joint["upper"] == 0)
    limits = f"{factor * joint['lower']:.0f} to {factor * joint['upper']:.0f} {unit}"
    keys = [f"{joint['name']}.{k}" for k in "xyz"] if ball else [joint["name"]]
    values = [state.get(key, 0.0) for key in keys]
    return [
        joint["name"],
        joint["type"],
        f"{joint['parent']} → {joint['child']}",
        "any" if ball else "(" + ", ".join(f"{v:.2f}" for v in joint["axis"]) + ")",
        "unlimited" if unlimited else limits,
        f"{factor * (math.hypot(*values) if ball else values[0]):.0f} {unit}",
        f"{joint['damping']:.2g}",
    ]


def penetrations(run: dict[str, Any]) -> Markup:
    """Return the section with penetrations and free-fall drift, before and after Step 5."""
    title = "Penetrations and drift"
    after = run["metrics"]
    before = after.get("before") or {}
    if "depths_m" not in after:
        return elements.section(
            title, elements.missing(f"Measured after refine; {progress_of(run)}.")
        )
    old, new = before.get("depths_m", {}), after["depths_m"]
    limit = run["config"]["refine"]["max_depth_m"]
    pairs = [
        [
            pair.replace("|", " – "),
            mm(old.get(pair, 0.0)) if before else "",
            mm(new.get(pair, 0.0)),
            elements.verdict(new.get(pair, 0.0) <= limit),
        ]
        for pair in sorted({*old, *new}, key=lambda p: -max(old.get(p, 0.0), new.get(p, 0.0)))
    ]
    tilts = [metrics.get("tilt_deg", {}) for metrics in (before, after)]
    motions = [
        [
            name,
            mm(before.get("drift_m", {}).get(name)),
            mm(drift),
            *("" if name not in tilt else f"{tilt[name]:.2f}°" for tilt in tilts),
        ]
        for name, drift in after.get("drift_m", {}).items()
    ]
    heads = ["pair", "#depth composed, mm", "#depth refined, mm", "verdict"]
    motion_heads = [
        *("object", "#drift composed, mm", "#drift refined, mm"),
        *("#turn composed", "#turn refined"),
    ]
    none = "No two objects intersect, neither before nor after refinement."
    return elements.section(
        title,
        elements.table(heads, pairs) if pairs else elements.paragraph(none),
        elements.table(motion_heads, motions) if motions else "",
    )
