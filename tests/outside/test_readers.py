"""One reader for each kind of outside file: bounds, regular files, one message with the name."""

import ast
import io
import json
import os
import sys
import zipfile
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
    read_outside_text,
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
        lambda: read_outside_text(path, SpecError),
        lambda: read_arrays(path, SpecError),
    ):
        with pytest.raises(SpecError, match=f"cannot read {path}"):
            read()
    with pytest.raises(ConfigError, match=f"cannot read plan {path}"):
        read_yaml(path, "plan")


def test_large_files_are_refused_unread(tmp_path):
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
def test_json_that_is_none_or_too_much(tmp_path, text, said):
    path = tmp_path / "a.json"
    path.write_text(text)
    with bounded_by(SMALL), pytest.raises(SpecError, match=rf"a\.json.*{said}"):
        read_json(path, SpecError)


def test_json_nested_without_end(tmp_path):
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
def test_yaml_that_is_none_or_too_much(tmp_path, text, said):
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
)
def test_arrays_that_are_none_or_too_much(tmp_path, data, said):
    path = tmp_path / "a.npz"
    path.write_bytes(data)
    with bounded_by(SMALL), pytest.raises(RunError, match=rf"a\.npz.*{said}"):
        read_arrays(path, RunError)


def test_arrays_come_back_as_they_were(tmp_path):
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


def test_pictures_of_other_formats_reach_no_other_program(tmp_path, monkeypatch):
    def started(*_: object, **__: object):
        raise AssertionError("Ghostscript was started")

    monkeypatch.setattr("PIL.EpsImagePlugin.Ghostscript", started)
    with pytest.raises(RunError, match=r"photo\.png is not an image in a supported format"):
        with open_image(EPS, "photo.png", RunError) as image:
            image.load()
    (tmp_path / "photo.png").write_bytes(EPS)
    with pytest.raises(PhotoError, match="not an image"):
        load_photo(tmp_path / "photo.png")


def test_pictures_of_too_many_pixels_are_refused_by_their_header():
    data = io.BytesIO()
    Image.new("1", (2000, 2000)).save(data, "PNG")
    with bounded_by(FileOptions(max_picture_mpx=1)):
        with pytest.raises(PhotoError, match=r"a\.png: 2000 x 2000 pixels, 4 megapixels"):
            with open_image(data.getvalue(), "a.png", PhotoError):
                pass


def _calls(path: Path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield node, ast.unparse(node.func)


def test_every_opening_of_a_picture_names_its_formats():
    for path in LIBRARY.rglob("*.py"):
        for call, name in _calls(path):
            if name == "Image.open":
                assert "formats" in {word.arg for word in call.keywords}, f"{path}:{call.lineno}"


READERS = {"np.load", "yaml.safe_load", "yaml.load", "json.load"}


def test_no_file_is_read_beside_the_readers():
    # The pages of the documentation are written from files of the repository itself.
    for path in set(LIBRARY.rglob("*.py")) - {LIBRARY / "config" / "pages.py"}:
        for call, name in _calls(path):
            assert name not in READERS, f"{path}:{call.lineno}: use neoworld_mjx.io"


def test_numbers_of_python_stay_bounded():
    """The bound by which huge integers in JSON and YAML end in an error."""
    assert 0 < sys.get_int_max_str_digits() <= 4300
    with pytest.raises(ValueError, match="4300"):
        json.loads("9" * 5000)
