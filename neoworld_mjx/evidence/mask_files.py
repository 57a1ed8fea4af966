"""Readers of masks, and their assignment to the objects of a scene tree."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from ..errors import EvidenceError
from ..io import read_arrays, read_json
from ..spec import SceneTree, TreeNode
from .depth_files import check_side, read_gray
from .masks import Masks

MAX_MASKS = 1000
MIN_OVERLAP = 0.4
"""Least overlap (IoU) of a mask's box with the 2D box of an object."""
BACKGROUND = ("background", "bg", "unlabeled", "0")


def read_masks(path: Path, names: Path | None = None) -> Masks:
    """Read masks.

    Args:
        path: an image or .npy with the number of an object at each pixel and 0 elsewhere, or a
            folder with an image of each object, NAME.png, which is 0 where the object is not.
        names: JSON file with the number of each object by name, or the name by number; by default
            the file next to `path` with the same name and the suffix .json, if there is one.

    Raises:
        EvidenceError: a file cannot be read, or holds no masks.
    """
    path = Path(path)
    if path.is_dir():
        if names is not None:
            raise EvidenceError(f"{path}: the names of masks are those of its files; omit {names}")
        return _read_folder(path)
    labels = _labels(path)
    numbers = [int(n) for n in np.unique(labels) if n]
    if not numbers:
        raise EvidenceError(f"{path} has no masks: all of its pixels are 0")
    if len(numbers) > MAX_MASKS:
        raise EvidenceError(
            f"{path} has {len(numbers)} different numbers, so it is no image of masks; the limit "
            f"is {MAX_MASKS}"
        )
    beside = path.with_suffix(".json")
    if names is None and beside.is_file():
        names = beside
    return Masks(labels, {} if names is None else _names(names, numbers, path), path.name)


def _labels(path: Path) -> Int[np.ndarray, "row column"]:
    if path.suffix.lower() in (".npy", ".npz"):
        arrays = read_arrays(path, EvidenceError)
        values = next(iter(arrays.values())) if len(arrays) == 1 else arrays.get("masks")
        if values is None:
            raise EvidenceError(f"{path} has {len(arrays)} arrays: name the one to use masks")
    else:
        values = read_gray(path)
    if values.ndim == 3 and values.dtype.kind in "biuf" and values.shape[0] <= MAX_MASKS:
        stack, areas = values, np.zeros(len(values) + 1)
        values = np.zeros(stack.shape[1:], np.int32)
        for number, mask in enumerate(stack, start=1):
            _add(values, areas, mask != 0, number)
    if values.ndim != 2 or values.dtype.kind not in "biu":
        raise EvidenceError(
            f"{path} holds {values.dtype} of shape {values.shape}; masks are integers with two axes"
        )
    check_side(values, path)
    if values.dtype.kind == "i" and values.min() < 0:
        values = np.maximum(values, 0)
    return values.astype(np.int32)


def _read_folder(folder: Path) -> Masks:
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".png")
    if not 0 < len(files) <= MAX_MASKS:
        raise EvidenceError(f"{folder} has {len(files)} PNG files; expected 1 to {MAX_MASKS}")
    labels: NDArray = np.zeros((0, 0), np.int32)
    areas = np.zeros(len(files) + 1)
    for number, file in enumerate(files, start=1):
        mask = read_gray(file) != 0
        check_side(mask, file)
        if number == 1:
            labels = np.zeros(mask.shape, np.int32)
        if mask.shape != labels.shape:
            own, other = (f"{m.shape[1]} x {m.shape[0]}" for m in (mask, labels))
            raise EvidenceError(f"{file} has {own} pixels, and {files[0].name} {other}")
        if not mask.any():
            raise EvidenceError(f"{file} is empty: all of its pixels are 0")
        _add(labels, areas, mask, number)
    return Masks(labels, {file.stem: k for k, file in enumerate(files, start=1)}, folder.name)


def _add(labels: NDArray, areas: NDArray, mask: NDArray, number: int) -> None:
    """Add a mask to labels, in place; where masks overlap, the smallest wins.

    Args:
        labels: number at each pixel.
        areas: number of pixels of each mask, by its number; that of `number` is set.
        mask: the mask.
        number: its number.
    """
    areas[number] = mask.sum()
    labels[mask & ((labels == 0) | (areas[labels] > areas[number]))] = number


def _names(file: Path, numbers: list[int], path: Path) -> dict[str, int]:
    value = read_json(file, EvidenceError, "names of masks")
    if not isinstance(value, dict) or len(value) > MAX_MASKS:
        raise EvidenceError(f"{file} must hold a JSON object with the number of each name")
    names: dict[str, int] = {}
    for key, entry in value.items():
        if isinstance(entry, int) and not isinstance(entry, bool):
            name, number = key, entry
        elif isinstance(entry, str) and key.isdigit():
            name, number = entry, int(key)
        else:
            raise EvidenceError(
                f'{file}: {key[:40]!r} is not NAME: number, as in {{"mug": 3}}, or "number": NAME'
            )
        if number == 0 or name.lower() in BACKGROUND:
            continue
        names[name] = number
    absent = [f"{name} ({number})" for name, number in names.items() if number not in numbers]
    if absent:
        raise EvidenceError(
            f"{file} names masks that {path.name} does not have: {', '.join(absent[:5])}; it has "
            f"the numbers {', '.join(map(str, numbers[:12]))}"
        )
    return names


def matched_to(masks: Masks, tree: SceneTree) -> tuple[Masks, tuple[str, ...]]:
    """Assign masks without the name of an object to the objects whose 2D boxes they overlap most.

    Args:
        masks: the masks, in the view of the tree's camera.
        tree: the tree.

    Returns:
        The masks with the names of the tree alone, and a note for each mask that no object has.
    """
    known = {node.name for node in tree.nodes}
    names = {name: number for name, number in masks.names.items() if name in known}
    given = {number: name for name, number in masks.names.items()}
    numbers = [int(n) for n in np.unique(masks.labels) if n and n not in names.values()]
    nodes = [node for node in tree.nodes if node.name not in names]
    # Objects choose before environment supports, whose boxes contain those of the objects.
    for environment in (False, True):
        rest = [node for node in nodes if node.environment == environment]
        chosen = _assigned(masks, numbers, rest, tree)
        names |= chosen
        numbers = [number for number in numbers if number not in chosen.values()]
    unmatched = [f"{given[n]} ({n})" if n in given else str(n) for n in numbers]
    notes = [f"no object of the scene has the mask {mask} of {masks.source}" for mask in unmatched]
    return replace(masks, names=names), tuple(notes)


def _assigned(
    masks: Masks, numbers: list[int], nodes: list[TreeNode], tree: SceneTree
) -> dict[str, int]:
    from scipy.optimize import linear_sum_assignment

    if not numbers or not nodes:
        return {}
    height, width = masks.labels.shape
    per_pixel = np.array([tree.camera.width / width, tree.camera.height_px / height] * 2)
    boxes = np.array([_box(masks.labels == number) for number in numbers]) * per_pixel
    others = np.array([[n.box2d.x0, n.box2d.y0, n.box2d.x1, n.box2d.y1] for n in nodes])
    overlap = _ious(boxes, others)
    rows, columns = linear_sum_assignment(-overlap)
    pairs: Mapping[int, int] = dict(zip(columns.tolist(), rows.tolist(), strict=True))
    return {
        nodes[column].name: numbers[row]
        for column, row in pairs.items()
        if overlap[row, column] >= MIN_OVERLAP
    }


def _box(mask: NDArray) -> list[float]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return [float(n) for n in (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)]


def _ious(a: Float[np.ndarray, "n 4"], b: Float[np.ndarray, "m 4"]) -> Float[np.ndarray, "n m"]:
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    both = np.prod(np.maximum(high - low, 0), axis=-1)
    area = lambda box: np.prod(box[:, 2:] - box[:, :2], axis=-1)
    union = area(a)[:, None] + area(b)[None] - both
    return both / np.maximum(union, 1e-9)
