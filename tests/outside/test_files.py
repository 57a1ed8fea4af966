"""Reading and hashing within bounds, at the bounds themselves."""

import errno
import hashlib
from pathlib import Path

import pytest

from neoworld_mjx.io import files
from neoworld_mjx.io.files import content_hash, irregular_entry, read_bytes, read_text, stays_inside


@pytest.mark.parametrize("size", [0, 1, 4095, 4096, 10_000])
def test_a_file_may_have_as_many_bytes_as_the_limit(tmp_path, size):
    path = tmp_path / "file"
    path.write_bytes(bytes(range(256)) * (size // 256) + bytes(size % 256))
    assert read_bytes(path, size) == path.read_bytes()
    assert read_bytes(path, size + 1) == path.read_bytes()
    if size:
        with pytest.raises(OSError, match="the limit is") as refused:
            read_bytes(path, size - 1)
        assert refused.value.errno == errno.EFBIG and refused.value.filename == str(path)


def test_the_size_in_a_refusal_is_that_of_the_file(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(bytes(3 << 20))
    with pytest.raises(OSError, match=r"it has 3 MiB; the limit is 1\.5 MiB"):
        read_bytes(path, 3 << 19)


def test_a_file_that_states_no_size_is_read_within_the_limit():
    """Files of the kernel have a size of 0, as has one that another program just begins."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("needs /proc")
    assert read_bytes(status, 1 << 20).startswith(b"Name:")
    with pytest.raises(OSError, match="the limit is"):
        read_bytes(status, 10)


def test_links_are_followed_unless_they_are_refused(tmp_path):
    (tmp_path / "file").write_text("text")
    (tmp_path / "link").symlink_to("file")
    assert read_text(tmp_path / "link", 4) == "text"
    with pytest.raises(OSError, match="it is a link"):
        read_bytes(tmp_path / "link", 4, follow=False)
    (tmp_path / "file").write_bytes(b"\xff")
    with pytest.raises(OSError, match="it is not a text file"):
        read_text(tmp_path / "file", 4)


def test_the_hash_of_a_folder_is_that_of_its_names_and_contents(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "c").write_bytes(b"content")
    content = hashlib.sha256(b"content").hexdigest()
    assert content_hash(tmp_path / "b" / "c") == content_hash(b"content") == content
    assert content_hash(tmp_path) == hashlib.sha256(f"b/c\0{content}\n".encode()).hexdigest()
    assert content_hash({"b": 1, "a": [2]}) == hashlib.sha256(b'{"a": [2], "b": 1}').hexdigest()
    with pytest.raises(FileNotFoundError):
        content_hash(tmp_path / "none")


@pytest.mark.parametrize("name", ["a", "a/b", "a..b/.c", "..."])
def test_names_that_stay_in_their_folder(name):
    assert stays_inside(name)


@pytest.mark.parametrize("name", ["", "/a", "a/", "a//b", "../a", "a/..", "./a", "a\\b", "a\0"])
def test_names_that_may_leave_their_folder(name):
    assert not stays_inside(name)


def test_the_first_entry_that_is_no_file_or_folder_is_named(tmp_path, monkeypatch):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "c").touch()
    assert irregular_entry(tmp_path) is None
    # Two folders and a file.
    monkeypatch.setattr(files, "_MAX_ENTRIES", 3)
    assert irregular_entry(tmp_path) is None
    monkeypatch.setattr(files, "_MAX_ENTRIES", 2)
    assert irregular_entry(tmp_path) == ("a/b/c", "one of more than 2 files")
    (tmp_path / "a" / "b" / "c").unlink()
    (tmp_path / "a" / "b" / "c").symlink_to("..")
    assert irregular_entry(tmp_path) == ("a/b/c", "a link")
