"""Aria Digital Twin: boxes of all objects of a recording, in its world.

    DATA/scene_objects.csv          poses of objects, static (timestamp -1) and moving
    DATA/3d_bounding_box.csv        their boxes
    DATA/instances.json             their names
    DATA/2d_bounding_box.csv        optional: which objects a camera sees

Format: facebookresearch/projectaria_tools, website/docs/open_datasets/aria_digital_twin_dataset.
The images are in VRS recordings, which need projectaria_tools; so are the cameras. Objects are
therefore compared in the world, by their boxes.
"""

import csv
import io
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from neoworld_mjx.errors import SpecError
from neoworld_mjx.io import read_object, read_untrusted_text
from neoworld_mjx.io.names import identifier

from .true_views import PosedObject, TrueView

POSES, BOXES, NAMES, SEEN = (
    "scene_objects.csv",
    "3d_bounding_box.csv",
    "instances.json",
    "2d_bounding_box.csv",
)
STATIC = -1
"""Timestamp of objects that never move."""
RGB_STREAM = "214-1"
LEAST_VISIBLE = 0.1
POSE_COLUMNS = tuple(f"t_wo_{axis}[m]" for axis in "xyz") + tuple(f"q_wo_{k}" for k in "wxyz")
BOX_COLUMNS = tuple(f"p_local_obj_{axis}{end}[m]" for axis in "xyz" for end in ("min", "max"))
TRIANGLES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)
"""Of a box whose corners are in the order of x, y, z, the last fastest."""


class TimedNumbers(NamedTuple):
    """A row of a table of one object."""

    time: int
    """[ns]; STATIC for objects that never move."""
    values: Float[np.ndarray, " n"]


def is_aria_twin(path: Path) -> bool:
    """Return True if a folder is a recording of Aria Digital Twin, or holds some."""
    return bool(_recordings(path))


def aria_views(path: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read the objects of recordings at given times.

    A view is named RECORDING_NANOSECONDS, or RECORDING for its first time. Objects that move have
    the pose with the nearest timestamp. With 2d_bounding_box.csv only objects of which the RGB
    camera sees a tenth at that time are read.

    Args:
        path: a recording, or a folder of some.
        names: of the views to read, as far as there are any.

    Raises:
        SpecError: a file is missing or broken.
    """
    for folder in _recordings(path):
        times = sorted(
            (int(digits or -1), name)
            for name in names
            for digits in re.findall(rf"{re.escape(folder.name)}(?:_(\d{{1,18}}))?\Z", name)
            if name.startswith(folder.name)
        )
        if not times:
            continue
        poses, boxes = _table(folder / POSES, POSE_COLUMNS), _table(folder / BOXES, BOX_COLUMNS)
        instances = read_object(folder / NAMES, SpecError)
        visible_ids = _read_visible_ids(folder / SEEN) if (folder / SEEN).is_file() else None
        for time, name in times:
            visible = None if visible_ids is None else _visible_at(visible_ids, time)
            yield TrueView(name, _objects(folder, poses, boxes, instances, time, visible))


def _recordings(path: Path) -> list[Path]:
    folders = [path, *(sorted(folder for folder in path.iterdir() if folder.is_dir()))]
    return [
        folder for folder in folders if all((folder / f).is_file() for f in (POSES, BOXES, NAMES))
    ]


def _table(file: Path, columns: tuple[str, ...]) -> dict[str, list[TimedNumbers]]:
    """Return the rows of a table by object."""
    result: dict[str, list[TimedNumbers]] = {}
    for number, row in enumerate(_rows(file, ("object_uid", "timestamp[ns]", *columns)), start=2):
        try:
            values = np.array([float(row[column]) for column in columns])
            time = int(row["timestamp[ns]"])
        except (TypeError, ValueError):
            raise SpecError(f"{file}, line {number}: a value is no number") from None
        if not np.isfinite(values).all():
            raise SpecError(f"{file}, line {number}: a number is not finite")
        uid = row["object_uid"]
        result.setdefault(uid, []).append(TimedNumbers(time, values))
    return result


def _rows(file: Path, columns: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    reader = csv.DictReader(io.StringIO(read_untrusted_text(file, SpecError)))
    missing = [name for name in columns if name not in (reader.fieldnames or ())]
    if missing:
        raise SpecError(f"{file} has no column {missing[0]}")
    try:
        yield from reader
    except csv.Error as error:
        raise SpecError(f"{file} is no table: {error}") from None


def _read_visible_ids(file: Path) -> dict[int, set[str]]:
    """Return the objects that the RGB camera sees, by time."""
    result: dict[int, set[str]] = {}
    columns = ("stream_id", "object_uid", "timestamp[ns]", "visibility_ratio[%]")
    for number, row in enumerate(_rows(file, columns), start=2):
        try:
            if row["stream_id"] == RGB_STREAM:
                objects = result.setdefault(int(row["timestamp[ns]"]), set())
                if _ratio(row["visibility_ratio[%]"]) >= LEAST_VISIBLE:
                    objects.add(row["object_uid"])
        except (TypeError, ValueError):
            raise SpecError(f"{file}, line {number}: a value is no number") from None
    return result


def _ratio(text: str) -> float:
    """Return a visibility ratio; projectaria_tools reads what is no number as unknown: not seen."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _visible_at(visible_ids: Mapping[int, set[str]], time: int) -> set[str]:
    return (
        visible_ids[min(visible_ids, key=lambda stamp: abs(stamp - time))] if visible_ids else set()
    )


def _nearest_in_time(rows: list[TimedNumbers], time: int) -> TimedNumbers:
    return min(rows, key=lambda row: 0 if row.time == STATIC else abs(row.time - time))


def _objects(
    folder: Path,
    poses: Mapping[str, list[TimedNumbers]],
    boxes: Mapping[str, list[TimedNumbers]],
    instances: Mapping[str, Any],
    time: int,
    visible: set[str] | None,
) -> tuple[PosedObject, ...]:
    objects: list[PosedObject] = []
    for uid, rows in poses.items():
        instance = instances.get(uid)
        if uid not in boxes or (visible is not None and uid not in visible):
            continue
        if isinstance(instance, Mapping) and instance.get("instance_type") == "human":
            continue
        label = instance.get("instance_name") if isinstance(instance, Mapping) else None
        name = identifier(str(label or uid), "object", {item.name for item in objects})
        values = _nearest_in_time(rows, time).values
        norm = float(np.linalg.norm(values[3:]))
        if abs(norm - 1) > 1e-2:
            raise SpecError(f"{folder / POSES}: the quaternion of {uid[:40]} has the norm {norm:g}")
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(values[3:], scalar_first=True).as_matrix()
        pose[:3, 3] = values[:3]
        low, high = _nearest_in_time(boxes[uid], time).values.reshape(3, 2).T
        corners = np.array(np.meshgrid(*zip(low, high, strict=True), indexing="ij"))
        diameter = float(np.linalg.norm(high - low))
        objects.append(
            PosedObject(name, corners.reshape(3, -1).T, TRIANGLES, pose, diameter, meshed=False)
        )
    return tuple(objects)
