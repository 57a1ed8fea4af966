"""Every kind of picture becomes upright RGB bytes, or one message that names the file."""

import hashlib
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import PhotoError
from neoworld_mjx.parse.photo import load_photo


def gradient(width: int = 40, height: int = 30) -> np.ndarray:
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[..., 0] = np.linspace(0, 255, width)
    rgb[..., 1] = np.linspace(0, 255, height)[:, None]
    rgb[..., 2] = 90
    return rgb


def saved(path, image, **options):
    image.save(path, **options)
    return path


def test_plain_picture_is_unchanged(tmp_path):
    path = saved(tmp_path / "a.png", Image.fromarray(gradient()))
    photo = load_photo(path)
    np.testing.assert_array_equal(photo.rgb, gradient())
    assert photo.rgb.dtype == np.uint8
    assert (photo.size, photo.original_size, photo.scale) == ((40, 30), (40, 30), 1.0)
    assert photo.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_followed(tmp_path, orientation):
    undo = {
        2: Image.Transpose.FLIP_LEFT_RIGHT,
        3: Image.Transpose.ROTATE_180,
        4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE,
        6: Image.Transpose.ROTATE_90,
        7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }
    stored = Image.fromarray(gradient())
    if orientation in undo:
        stored = stored.transpose(undo[orientation])
    exif = Image.Exif()
    exif[0x0112] = orientation
    photo = load_photo(saved(tmp_path / "a.png", stored, exif=exif))
    np.testing.assert_array_equal(photo.rgb, gradient())
    assert photo.original_size == (40, 30)


def test_alpha_is_laid_on_white(tmp_path):
    rgba = np.dstack([gradient(), np.zeros((30, 40), np.uint8)])
    rgba[:, 20:, 3] = 255
    photo = load_photo(saved(tmp_path / "a.png", Image.fromarray(rgba)))
    assert (photo.rgb[:, :20] == 255).all()
    np.testing.assert_array_equal(photo.rgb[:, 20:], gradient()[:, 20:])


@pytest.mark.parametrize("suffix", ["png", "gif", "bmp", "tif", "webp", "ppm", "tga", "ico", "jp2"])
def test_formats(tmp_path, suffix):
    options = {"lossless": True} if suffix == "webp" else {}
    image = Image.fromarray(gradient(32, 32))
    if suffix == "ico":
        options = {"sizes": [(32, 32)]}
    photo = load_photo(saved(tmp_path / f"a.{suffix}", image, **options))
    assert photo.size == (32, 32)
    assert np.abs(photo.rgb.astype(int) - gradient(32, 32)).mean() < 12


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bit_grey_keeps_its_tones(tmp_path, suffix):
    deep = (gradient()[..., 0].astype(np.uint16)) * 257
    photo = load_photo(saved(tmp_path / f"a.{suffix}", Image.fromarray(deep)))
    np.testing.assert_array_equal(photo.rgb[..., 1], gradient()[..., 0])


def png(width: int, height: int, depth: int, colour: int, row: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = zlib.compress((b"\x00" + row) * min(height, 64))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def test_large_picture_is_shrunk(tmp_path):
    path = saved(tmp_path / "a.png", Image.fromarray(gradient(3000, 2001)))
    photo = load_photo(path, max_side_px=600)
    assert photo.size == (600, 400)
    assert photo.original_size == (3000, 2001)
    assert photo.scale == 0.2
    assert np.abs(photo.rgb.astype(int) - gradient(600, 400)).max() <= 3


def broken(tmp_path, kind: str):
    path = tmp_path / "p.png"
    whole = saved(tmp_path / "whole.png", Image.effect_noise((200, 200), 90)).read_bytes()
    jpeg = saved(tmp_path / "whole.jpg", Image.effect_noise((200, 200), 90)).read_bytes()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "tiny":
        Image.new("RGB", (1, 1)).save(path)
    elif kind == "thin":
        Image.new("RGB", (40, 15)).save(path)
    elif kind == "long":
        Image.new("RGB", (20000, 20)).save(path)
    elif kind != "missing":
        data = {
            "text": b"not a picture\n",
            "empty": b"",
            "cut png": whole[: len(whole) // 2],
            "cut jpeg": jpeg[: len(jpeg) // 2],
            "header only": whole[:40],
            "postscript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 100 100\n%%EndComments\n",
        }
        path.write_bytes(data[kind])
    return path


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "no such file"),
        ("folder", "is a folder"),
        ("pipe", "not a regular file"),
        ("text", "not an image.*save it as PNG or JPEG"),
        ("empty", "not an image"),
        ("postscript", "not an image"),
        ("cut png", "damaged or truncated"),
        ("cut jpeg", "damaged or truncated"),
        ("header only", "not an image"),
        ("tiny", "1 x 1 pixels is too small; at least 16"),
        ("thin", "40 x 15 pixels is too small"),
        ("long", "too long and narrow"),
    ],
)
def test_bad_files_are_one_message_with_their_name(tmp_path, kind, words):
    path = broken(tmp_path, kind)
    with pytest.raises(PhotoError, match=words) as caught:
        load_photo(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.__suppress_context__ or caught.value.__context__ is None


def test_a_small_photo_is_shown_enlarged_by_a_whole_factor(tmp_path):
    path = saved(tmp_path / "a.png", Image.fromarray(np.full((24, 40, 3), 7, np.uint8)))
    photo = load_photo(path, 1568, 100)
    assert (photo.size, photo.original_size, photo.scale) == ((120, 72), (40, 24), 3)
    assert load_photo(path, 100, 100).size == (80, 48)
    assert load_photo(path, 1568, 40).size == (40, 24)
