"""One row an object: photograph, render in the same frame, words, agreement and verdict."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .changes import all_moves
from .page import Html, cut_out, missing, picture, section, text, verdict
from .tables import read_json, verdicts, with_unit

TITLE = "Objects"
MARGIN = 0.12
"""Room around an object in its picture, over the size of its box."""


def object_rows(folder: Path, run: Mapping[str, Any], tree: Mapping[str, Any]) -> Html:
    """Show each object in a row that opens to its checks; those that fail come first and are open.

    Args:
        folder: the run folder.
        run: run.json.
        tree: tree.json; empty before the parse.
    """
    nodes = {node["name"]: node for node in tree.get("nodes", [])}
    homes = {path.name: path for path in (folder / "objects").glob("*") if path.is_dir()}
    if not homes:
        return section(TITLE, missing("No objects yet."))
    moves, causes = all_moves(folder), unstable(run)
    agreement = (run["metrics"].get("box_iou") or {}).get("objects", {})
    rows = []
    for name, home in sorted(homes.items()):
        verification = read_json(home / "verify.json")
        passed = None if verification is None else bool(verification.get("passed"))
        if name in causes:
            passed = False
        node = nodes.get(name, {})
        words = _words(node, moves.get(name, []), agreement.get(name, {}), causes.get(name, []))
        summary = (
            f'<div class="shots">{_shots(folder, home, node, tree.get("camera"))}</div>'
            f"<div><b>{text(name)}</b> {words}</div>"
            f'<div class="verdict">{verdict(passed) if verification else ""}</div>'
        )
        opened = " open" if passed is False else ""
        details = verdicts(home, verification)
        row = f'<details class="object"{opened}><summary>{summary}</summary>{details}</details>'
        rows.append((passed is not False, row))
    rows.sort(key=lambda row: row[0])
    failed = sum(not good for good, _ in rows)
    told = f"{failed} of {len(rows)} fail" if failed else f"All {len(rows)} hold"
    note = f'<p class="dim">{told}; a row opens to its checks.</p>'
    return section(TITLE, note, *(row for _, row in rows))


def unstable(run: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return what is wrong with each object of the refined scene, in words; empty if all hold."""
    measured, limits = run["metrics"], run["config"]["refine"]
    causes: dict[str, list[str]] = {}

    def add(names: str, said: str) -> None:
        for name in names.split("|"):
            causes.setdefault(name, []).append(said)

    kinds = (
        ("depths_m", "max_depth_m", "m", "lies {value} deep in {other} (limit {limit})"),
        ("settled_depths_m", "max_depth_m", "m", "settles {value} deep in {other} (limit {limit})"),
        ("drift_m", "max_drift_m", "m", "moves by {value} (limit {limit})"),
        ("tilt_deg", "max_tilt_deg", "°", "turns by {value} (limit {limit})"),
        ("joint_slide_m", "max_drift_m", "m", "{joint} slides by {value} (limit {limit})"),
        ("joint_turn_deg", "max_tilt_deg", "°", "{joint} turns by {value} (limit {limit})"),
    )
    for key, bound, unit, phrase in kinds:
        for names, value in (measured.get(key) or {}).items():
            within = value <= limits[bound] if "depth" in key else value < limits[bound]
            if within:
                continue
            first, _, other = names.partition("|")
            name, _, joint = first.partition("-")
            said = phrase.format(
                other=other,
                joint=joint,
                value=with_unit(value, unit),
                limit=with_unit(limits[bound], unit),
            )
            add(name, said.replace(" °", "°"))
    return causes


def _words(
    node: Mapping[str, Any],
    moves: list[tuple[str, str]],
    agreement: Mapping[str, Any],
    causes: list[str],
) -> Html:
    """Return what each step said or did, and how far the boxes agree."""
    entries: list[tuple[str, object]] = []
    if causes:
        entries.append(("not valid", Html(f'<span class="bad">{text("; ".join(causes))}</span>')))
    if node:
        size = " × ".join(f"{100 * v:.1f}" for v in node["box3d"]["size"])
        stands = f"{node.get('relation', 'on')} {node['parent']}" if node.get("parent") else "world"
        entries.append(("parse", f"{node['label']}, {stands}, {size} cm"))
    entries += moves
    if agreement.get("refined") is not None:
        steps = ("parsed", "composed", "refined")
        seen = [f"{s} {agreement[s]:.2f}" for s in steps if agreement.get(s) is not None]
        entries.append(("boxes agree", ", ".join(seen)))
    rows = "".join(f"<dt>{text(who)}</dt><dd>{text(how)}</dd>" for who, how in entries)
    return Html(f"<dl>{rows}</dl>")


def _shots(folder: Path, home: Path, node: Mapping[str, Any], camera: Any) -> Html:
    """Return the object in the photograph and in the refined scene, in the same frame."""
    box = node.get("box2d")
    if box is None or not isinstance(camera, dict):
        shots = [(home / "crop.png", "photograph"), (home / "render.png", "program")]
        return Html("".join(picture(path, text) for path, text in shots if path.is_file()))
    width, height = camera["width"], camera["height_px"]
    room = MARGIN * max(box["x1"] - box["x0"], box["y1"] - box["y0"])
    window = (
        (box["x0"] - room) / width,
        (box["y0"] - room) / height,
        (box["x1"] + room) / width,
        (box["y1"] + room) / height,
    )
    after = folder / "pictures" / "after.png"
    scene = after if after.is_file() else folder / "pictures" / "before.png"
    return Html(
        cut_out(folder / "photo.png", window, "photograph")
        + cut_out(scene, window, "refined" if after.is_file() else "composed")
    )
