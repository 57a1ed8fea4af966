"""Pictures within the limit of pixels that need gigabytes when they are decoded."""

import resource
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import PhotoError, RunError
from neoworld_mjx.io import open_image
from neoworld_mjx.parse.photo import load_photo
from tests.support.hostile_assets import png

WIDTH, HEIGHT = 11_500, 11_600


def float_tiff(width: int, height: int) -> bytes:
    """Return a black TIFF of 32-bit floats, in one compressed strip."""
    pack = zlib.compressobj(1)
    strip = b"".join(pack.compress(bytes(4 * width)) for _ in range(height)) + pack.flush()
    tags = [
        *((256, width), (257, height), (258, 32), (259, 8), (262, 1), (273, 8), (277, 1)),
        *((278, height), (279, len(strip)), (339, 3)),
    ]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    strip += bytes(len(strip) % 2)
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    return struct.pack("<2sHI", b"II", 42, 8 + len(strip)) + strip + directory


PICTURES = {
    "floats.tif": lambda: float_tiff(WIDTH, HEIGHT),
    "grey.png": lambda: png(WIDTH, HEIGHT, depth=16, grey=True),
    "colour.png": lambda: png(WIDTH, HEIGHT),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_large_picture_costs_less_than_500_megabytes(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(PICTURES[name]())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(PhotoError, match=r"memory") as caught:
        load_photo(path)
    assert str(path) in str(caught.value)
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1000 < 500


def test_the_largest_photographs_of_phones_are_read(tmp_path):
    path = tmp_path / "a.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6
    grey = np.zeros((9000, 12_000), np.uint8)
    grey[:, 6000:] = 200
    Image.fromarray(grey).save(path, exif=exif)
    photo = load_photo(path, 600)
    assert photo.original_size == (9000, 12_000)
    assert photo.size == (450, 600)
    assert photo.rgb[100].max() < 5
    assert photo.rgb[500].min() > 195


def test_a_large_picture_of_a_run_folder_is_refused():
    with (
        pytest.raises(RunError, match="the limit is 16"),
        open_image(png(5000, 5000), "a", RunError),
    ):
        pass
