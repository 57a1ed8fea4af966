"""Photographs with the sensor's registered depth image.

DATA/NAME-depth.png       16 bits, registered to the photograph NAME
DATA/camera.json          {"fx": 1066.778, "fy": 1067.487, "cx": 312.987, "cy": 241.311,
                           "depth_scale": 0.1}, as BOP's camera.json
"""

from collections.abc import Collection, Iterator
from pathlib import Path

from neoworld_mjx.errors import SpecError
from neoworld_mjx.io import read_object

from ..measures.depth_measure import Intrinsics
from .true_views import TrueView, numbers, read_depth

ENDING = "-depth.png"
CAMERA = "camera.json"


def is_depth_folder(path: Path) -> bool:
    """Return True if a folder has depth images."""
    return any(path.glob(f"*{ENDING}"))


def depth_views(path: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read the depth images of a folder.

    Args:
        path: the folder.
        names: of the photographs to read, as far as there are any.

    Raises:
        SpecError: a file is missing or broken.
    """
    stated = read_object(path / CAMERA, SpecError)
    fx, fy, cx, cy, mm = (
        float(numbers(stated, key, 1, str(path / CAMERA))[0])
        for key in ("fx", "fy", "cx", "cy", "depth_scale")
    )
    if min(fx, fy, mm) <= 0:
        raise SpecError(f"{path / CAMERA}: focal lengths and the depth scale must be above 0")
    for file in sorted(path.glob(f"*{ENDING}")):
        name = file.name.removesuffix(ENDING)
        if name in names:
            depth = read_depth(file, mm)
            size = depth.shape[1], depth.shape[0]
            yield TrueView(name, (), Intrinsics(fx, fy, cx, cy), size, depth)
