"""Properties, checks and crop of one object, as HTML and pixels for the page."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from ...errors import NeoWorldError, SpecError
from ...io import read_model
from ...parse.crops import crops
from ...parse.photo import load_photo
from ...program import BuildResult
from ...spec import SceneObject, SceneTree, bounds, inertial
from ..report.changes import all_moves
from ..report.formatting import read_json, with_unit
from ..report.page import elements
from .page_html import framed, message
from .view_target import ViewTarget


def facts(target: ViewTarget, obj: SceneObject) -> str:
    """Return an object's properties, its changes in each step, and its checks, as HTML."""
    low, high = bounds(obj.spec, obj.joint_state)
    masses = [(part.name, inertial(obj.spec, part).mass) for part in obj.spec.parts]
    size = " x ".join(f"{100 * v:.1f}" for v in high - low)
    support = f"{obj.relation} {obj.parent}" if obj.parent else "world"
    rows: list[Sequence[object]] = [
        ["label", obj.spec.label or "none"],
        ["support", support + (", fixed" if obj.static else "")],
        ["size", f"{size} cm"],
        ["mass", f"{sum(mass for _, mass in masses):.3g} kg"],
    ]
    if len(masses) > 1:
        rows += [[f"mass of {name}", f"{mass:.3g} kg"] for name, mass in masses]
    if target.run is not None:
        rows += all_moves(target.run).get(obj.name, {}).items()
    parts = [elements.title(obj.name), elements.table(["", ""], rows)]
    object_folder = target.object_folder(obj.name)
    if object_folder is not None:
        parts.append(_verdicts(object_folder))
    return framed(*parts)


def signals_of(built: BuildResult) -> str:
    """Return the signals of a build as HTML."""
    if not built.signals:
        return message("Built: no signals.")
    rows = [[signal.severity, signal.phrase()] for signal in built.signals]
    return framed(elements.table(["", "signal"], rows))


def crop_of(target: ViewTarget, name: str) -> NDArray | None:
    """Return the crop of the photograph around an object, uint8 [h, w, 3]; None if unavailable."""
    if target.run is None or not (target.run / "tree.json").is_file():
        return None
    try:
        tree = read_model(target.run / "tree.json", SceneTree, SpecError, "a scene tree")
        if name not in {node.name for node in tree.nodes}:
            return None
        crop = crops(load_photo(target.run / "photo.png"), tree)[name]
    except NeoWorldError:
        return None
    with Image.open(io.BytesIO(crop.picture.data), formats=["PNG"]) as image:
        return np.asarray(image.convert("RGB"))


def _verdicts(object_folder: Path) -> Markup:
    verification = read_json(object_folder / "verify.json")
    if verification is None:
        return elements.paragraph("Not verified yet.")
    rows = [
        [
            elements.outcome(check.get("outcome"), bool(check.get("doubtful"))),
            f"{check.get('scenario', '')} {check.get('name', '')}".replace("_", " "),
            with_unit(check.get("value"), check.get("unit")),
            with_unit(check.get("threshold"), check.get("unit")),
        ]
        for check in verification.get("checks", [])
        if isinstance(check, dict)
    ]
    return elements.table(["verdict", "check", "#value", "#limit"], rows)
