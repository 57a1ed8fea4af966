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


def depth_views(
    path: Path,
    names: Collection[str],
    *,
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
) -> Iterator[TrueView]:
    """Read the depth images of a folder.

    Args:
        path: the folder.
        names: of the photographs to read, as far as there are any.
        intrinsics: fx, fy, cx and cy [px], in place of those of camera.json.
        depth_scale: millimeters of a unit, in place of that of camera.json.

    Raises:
        SpecError: a file is missing or broken, or the camera is nowhere stated.
    """
    files = {file.name.removesuffix(ENDING): file for file in sorted(path.glob(f"*{ENDING}"))}
    if intrinsics is None or depth_scale is None:
        if not (path / CAMERA).is_file():
            raise SpecError(
                f"{path} has no {CAMERA} with fx, fy, cx, cy and depth_scale; or give them as "
                "--intrinsics FX FY CX CY --depth-scale MM"
            )
        stated = read_object(path / CAMERA, SpecError)
        read = lambda key: float(numbers(stated, key, 1, str(path / CAMERA))[0])
        if intrinsics is None:
            intrinsics = read("fx"), read("fy"), read("cx"), read("cy")
        if depth_scale is None:
            depth_scale = read("depth_scale")
    camera = Intrinsics(*intrinsics)
    if min(camera.fx, camera.fy, depth_scale) <= 0:
        raise SpecError(f"{path}: focal lengths and the depth scale must be above 0")
    for name, file in files.items():
        if name in names:
            depth = read_depth(file, depth_scale)
            yield TrueView(name, (), camera, (depth.shape[1], depth.shape[0]), depth)
