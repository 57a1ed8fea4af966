"""Exported objects contain what was exported, as MuJoCo, yourdfpy and OpenUSD read them."""

import pytest

from neoworld_mjx.export import export_object
from tests.support.file_readers import READERS, check_contents, read_with_mujoco


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cabinet):
    out = tmp_path_factory.mktemp("readers")
    export_object(cabinet, out)
    return out


@pytest.mark.parametrize("file", READERS)
def test_readers_agree_with_the_spec(file, folder, cabinet):
    check_contents(READERS[file](folder / file), cabinet)


def test_mujoco_reads_urdf(folder, cabinet):
    check_contents(read_with_mujoco(folder / "object.urdf"), cabinet)


@pytest.mark.parametrize(
    "change", [{"mass": 99.0}, {"joints": 1}, {"colliders": 1}, {"origins": {"drawer": (9, 9, 9)}}]
)
def test_differences_are_detected(change, folder, cabinet):
    read = read_with_mujoco(folder / "object.xml")._replace(**change)
    with pytest.raises(AssertionError):
        check_contents(read, cabinet)
