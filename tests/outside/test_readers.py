"""Readers of untrusted files: bounds, regular files only, and one message with the file name."""

import ast
import io
import json
import os
import sys
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pydantic import BaseModel

from neoworld_mjx.config import FileOptions, load_config, read_yaml
from neoworld_mjx.errors import ConfigError, PhotoError, RunError, SpecError
from neoworld_mjx.io import (
    bounded_by,
    open_image,
    read_arrays,
    read_json,
    read_model,
    read_untrusted_text,
)
from neoworld_mjx.parse.photo import load_photo

LIBRARY = Path(__file__).parents[2] / "neoworld_mjx"
SMALL = FileOptions(max_text_mib=1, max_values=1000, max_depth=10, max_array_mib=1)


class _Pair(BaseModel):
    a: int
    b: list = []


def _special(tmp_path: Path, kind: str) -> Path:
    path = tmp_path / "file"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "circle":
        path.symlink_to(path)
    return path


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "circle", "missing"])
def test_only_regular_files_are_read(tmp_path, kind):
    path = _special(tmp_path, kind)
    for read in (
        lambda: read_json(path, SpecError),
        lambda: read_model(path, _Pair, SpecError, "a pair"),
        lambda: read_untrusted_text(path, SpecError),
        lambda: read_arrays(path, SpecError),
    ):
        with pytest.raises(SpecError, match=f"cannot read {path}"):
            read()
    with pytest.raises(ConfigError, match=f"cannot read plan {path}"):
        read_yaml(path, "plan")


def test_large_files_are_rejected_unread(tmp_path):
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(SpecError, match=r"large\.json: it has 1.05e\+06 MiB; the limit is 64 MiB"):
        read_json(path, SpecError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 400 + "]" * 400, "nested over 10 levels deep"),
        ('{"a":' * 20 + "1" + "}" * 20, "nested over 10 levels deep"),
        ("[" + "0," * 2000 + "0]", "over 1000 values.*files.max_values"),
        ('"\\ud800"', "unpaired surrogate"),
        ("NaN", "not JSON: NaN"),
        ("[1,", "not JSON"),
        ("9" * 5000, "not JSON"),
        ("", "not JSON"),
    ],
)
def test_invalid_or_oversized_json_is_rejected(tmp_path, text, said):
    path = tmp_path / "a.json"
    path.write_text(text)
    with bounded_by(SMALL), pytest.raises(SpecError, match=rf"a\.json.*{said}"):
        read_json(path, SpecError)


def test_deeply_nested_json_is_rejected(tmp_path):
    (tmp_path / "a.json").write_text("[" * 100_000 + "]" * 100_000)
    with pytest.raises(SpecError, match=r"a\.json is nested over 100 levels deep"):
        read_json(tmp_path / "a.json", SpecError)


def test_json_that_does_not_fit_its_model(tmp_path):
    path = tmp_path / "a.json"
    for text in ("[" * 100_000, '{"a": "x"}', '{"a": 1, "b": ["\\ud800"]}', "{}"):
        path.write_text(text)
        with pytest.raises(SpecError, match=r"a\.json is not a pair: "):
            read_model(path, _Pair, SpecError, "a pair")
    path.write_text('{"a": 1}')
    assert read_model(path, _Pair, SpecError, "a pair").a == 1


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, r"holds an alias \(\*name\): write out the values"),
        ("a: &a {seed: 1}\n<<: *a\n", "holds an alias"),
        ("a: &a\n  - *a\n", "holds an alias"),
        ("[" * 100_000, "nested over 100 levels"),
        ("{a: " * 50_000, "nested over 100 levels"),
        ("- " * 100_000, "nested over 100 levels"),
        ("!!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("seed: " + "9" * 5000, "not valid YAML"),
        ("? [a]\n: 1\n", "not valid YAML|unhashable"),
        ("seed: \0", "special characters are not allowed"),
        ("seed: 2001-99-99", "not valid YAML"),
    ],
)
def test_invalid_or_oversized_yaml_is_rejected(tmp_path, text, said):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        load_config(path)
    assert "a.yaml" in str(caught.value)
    assert len(str(caught.value)) < 2000


def test_yaml_that_is_too_large(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("seed: 1\n" + "#" * 300_000)
    with pytest.raises(ConfigError, match=r"a\.yaml: it has .* MiB; the limit is 0\.25 MiB"):
        load_config(path)


def _npz(header: bytes, data: bytes = b"") -> bytes:
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header + data)
    return whole.getvalue()


def _header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (_npz(_header((10**13,))), "declares 80000000000000 bytes"),
        (_npz(_header((2, 2)), bytes(16)), "declares 32 bytes but has 16"),
        (_npz(_header((-1,))), "invalid shape|declares"),
        (_npz(_header((1,), "|O"), bytes(8)), "Python objects"),
        (_npz(b"x" * 80), "no readable arrays"),
        (_npz(_header((2**20,)), bytes(2**23)), "unpacks to 8 MiB.*files.max_array_mib"),
        (b"no zip", "no readable arrays"),
        (b"PK\x03\x04" + bytes(100), "no readable arrays"),
    ],
    ids=["huge", "too long", "negative", "object", "no header", "bomb", "no zip", "cut off"],
)
def test_invalid_or_oversized_arrays_are_rejected(tmp_path, data, said):
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    with bounded_by(SMALL), pytest.raises(RunError, match=rf"a\.npz.*{said}"):
        read_arrays(path, RunError)


def test_arrays_round_trip(tmp_path):
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "names": np.array(["x", "yz"]),
        "empty": np.zeros((0, 4), np.float32),
        "scalar": np.array(3),
    }
    np.savez_compressed(tmp_path / "a.npz", allow_pickle=False, **arrays)
    read = read_arrays(tmp_path / "a.npz", RunError)
    assert list(read) == list(arrays)
    for name, value in arrays.items():
        np.testing.assert_array_equal(read[name], value)
        assert read[name].dtype == value.dtype


EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 100 100\n%%EndComments\n%%EOF\n"


def test_images_of_other_formats_start_no_other_program(tmp_path, monkeypatch):
    def started(*_: object, **__: object):
        raise AssertionError("Ghostscript was started")

    monkeypatch.setattr("PIL.EpsImagePlugin.Ghostscript", started)
    with pytest.raises(RunError, match=r"photo\.png is not an image in a supported format"):
        with open_image(EPS, "photo.png", RunError) as image:
            image.load()
    (tmp_path / "photo.png").write_bytes(EPS)
    with pytest.raises(PhotoError, match="not an image"):
        load_photo(tmp_path / "photo.png")


def test_images_with_too_many_pixels_are_rejected_before_decoding():
    data = io.BytesIO()
    Image.new("1", (2000, 2000)).save(data, "PNG")
    with bounded_by(FileOptions(max_picture_mpx=1)):
        with pytest.raises(PhotoError, match=r"a\.png: 2000 x 2000 pixels, 4 megapixels"):
            with open_image(data.getvalue(), "a.png", PhotoError):
                pass


@cache
def _calls() -> list[tuple[str, str, ast.Call]]:
    """Return the calls in the library's sources: file and line, function and call."""
    return [
        (f"{path}:{node.lineno}", ast.unparse(node.func), node)
        for path in LIBRARY.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


def test_every_opening_of_an_image_restricts_the_formats():
    for line, function, call in _calls():
        if function == "Image.open":
            assert "formats" in {keyword.arg for keyword in call.keywords}, line


UNBOUNDED = {"np.load", "yaml.safe_load", "yaml.load", "json.load"}


def test_files_are_only_read_by_the_bounded_readers():
    for line, function, _ in _calls():
        # The pages of options are generated from files of the repository itself.
        if "config/pages.py" not in line:
            assert function not in UNBOUNDED, f"{line}: use neoworld_mjx.io"


def test_text_files_are_utf_8_regardless_of_the_locale():
    for line, function, call in _calls():
        if function.endswith((".write_text", ".read_text")):
            arguments: set[object] = {keyword.arg for keyword in call.keywords}
            arguments |= {arg.value for arg in call.args if isinstance(arg, ast.Constant)}
            assert {"encoding", "utf-8"} & arguments, line


def test_python_bounds_the_length_of_integers():
    """Huge integers in JSON and YAML are errors because of this bound."""
    assert 0 < sys.get_int_max_str_digits() <= 4300
    with pytest.raises(ValueError, match="4300"):
        json.loads("9" * 5000)
