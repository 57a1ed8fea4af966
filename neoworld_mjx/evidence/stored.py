"""Evidence as a run keeps it: evidence.json, depth.npy, confidence.npy and masks.png."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import TypeAdapter, ValidationError

from ..errors import EvidenceError
from ..io import read_arrays, read_object
from .depth_files import read_gray
from .depth_image import DepthImage, DepthKind
from .evidence import Evidence
from .known_camera import KnownCamera
from .lens import Lens
from .masks import Masks

STATED = "evidence.json"
DEPTH, CONFIDENCE, MASKS = "depth.npy", "confidence.npy", "masks.png"
MAX_LABEL = 2**16 - 1


def evidence_files(evidence: Evidence) -> dict[str, bytes]:
    """Return the contents of the files that keep evidence, by name.

    The photograph is not among them. Numbers of masks are replaced by 1, 2, ... in their order.
    """
    stated: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    for name in ("camera", "lens"):
        value = getattr(evidence, name)
        if value is not None:
            stated[name] = dataclasses.asdict(value)
    if (depth := evidence.depth) is not None:
        stated["depth"] = {"kind": depth.kind, "smooth_sd": depth.smooth_sd, "source": depth.source}
        files[DEPTH] = _npy(depth.values)
        if depth.confidence is not None:
            files[CONFIDENCE] = _npy(depth.confidence)
    if (masks := evidence.masks) is not None:
        numbers = [int(n) for n in np.unique(masks.labels) if n]
        if len(numbers) > MAX_LABEL:
            raise EvidenceError(
                f"{masks.source} has {len(numbers)} masks; the limit is {MAX_LABEL}"
            )
        labels = np.searchsorted(numbers, masks.labels) + 1
        labels = np.where(masks.labels == 0, 0, labels).astype(np.uint16)
        names = {n: numbers.index(k) + 1 for n, k in masks.names.items() if k in numbers}
        stated["masks"] = {"names": names, "source": masks.source}
        buffer = io.BytesIO()
        Image.fromarray(labels).save(buffer, "PNG")
        files[MASKS] = buffer.getvalue()
    return {STATED: (json.dumps(stated, indent=1) + "\n").encode(), **files}


def read_stored(folder: Path) -> Evidence:
    """Read the evidence that a run keeps; empty evidence if the folder has none.

    Raises:
        EvidenceError: a file is damaged.
    """
    file = folder / STATED
    if not file.is_file():
        return Evidence()
    stated = read_object(file, EvidenceError)
    try:
        camera = TypeAdapter(KnownCamera | None).validate_python(stated.get("camera"))
        lens = TypeAdapter(Lens | None).validate_python(stated.get("lens"))
        depth = masks = None
        if "depth" in stated:
            values = stated["depth"]
            kind = TypeAdapter(DepthKind).validate_python(values["kind"])
            trust = None
            if (folder / CONFIDENCE).is_file():
                trust = _image(folder / CONFIDENCE)
            depth = DepthImage(
                _image(folder / DEPTH), kind, trust, float(values["smooth_sd"]), values["source"]
            )
        if "masks" in stated:
            names = TypeAdapter(dict[str, int]).validate_python(stated["masks"]["names"])
            labels = read_gray(folder / MASKS).astype(np.int32)
            masks = Masks(labels, names, str(stated["masks"]["source"]))
    except (ValidationError, KeyError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise EvidenceError(f"{file} is damaged: {reason}; give the evidence again") from None
    return Evidence(camera=camera, lens=lens, depth=depth, masks=masks)


def evidence_lines(evidence: Evidence) -> dict[str, str]:
    """Return a line on each kind of evidence, with its source, by the name of the kind."""
    lines = {}
    if (camera := evidence.camera) is not None:
        sources = "; ".join(filter(None, (camera.source, camera.focal_source)))
        lines["camera"] = f"{', '.join(camera_phrases(camera))} ({sources})"
    if (depth := evidence.depth) is not None:
        known = np.isfinite(depth.values)
        height, width = depth.values.shape
        unit = f", median {np.median(depth.values[known]):.2f} m" if depth.kind == "metric" else ""
        lines["depth"] = (
            f"{depth.kind}, {known.mean():.0%} of {width} x {height} pixels{unit} ({depth.source})"
        )
    if (masks := evidence.masks) is not None:
        count = len(np.unique(masks.labels[masks.labels != 0]))
        lines["masks"] = f"{count} masks, {len(masks.names)} with names ({masks.source})"
    if evidence.further:
        lines["views"] = "; ".join(photo.phrase() for photo in evidence.further)
    return lines | evidence.objects.lines()


def camera_phrases(camera: KnownCamera) -> list[str]:
    """Return a phrase on each known parameter of a camera."""
    phrases = []
    if camera.focal is not None:
        fovy = 2 * np.degrees(np.arctan(camera.size[1] / 2 / camera.focal))
        sd = f" +- {camera.focal_sd:.0%}" if camera.focal_sd > 0.001 else ""
        phrases.append(f"vertical field of view {fovy:.1f} deg{sd}")
    for name in ("pitch", "roll"):
        if (angle := getattr(camera, name)) is not None:
            phrases.append(f"{name} {np.degrees(angle):.1f} deg")
    if camera.height is not None:
        phrases.append(f"height {camera.height:.3f} m")
    if camera.base is not None:
        phrases.append("base frame known")
    return phrases


def _npy(values: NDArray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values.astype(np.float32), allow_pickle=False)
    return buffer.getvalue()


def _image(path: Path) -> NDArray:
    values = read_arrays(path, EvidenceError)[""]
    if values.ndim != 2 or values.dtype.kind != "f":
        raise ValueError(f"{path.name} is no image of numbers")
    return values.astype(float)
