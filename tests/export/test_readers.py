"""The readers of benchmarks/readers.py that are here, on an object with every joint and shape."""

import pytest

from benchmarks.motion import within
from benchmarks.motion_probe import MOVERS
from benchmarks.reader_probe import READERS
from benchmarks.readers import compare
from neoworld_mjx.export import export_object


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cabinet):
    out = tmp_path_factory.mktemp("readers")
    export_object(cabinet, out)
    return out


@pytest.mark.parametrize(
    ("reader", "suffix"),
    [("mujoco", "xml"), ("mujoco", "urdf"), ("yourdfpy", "urdf"), ("usd", "usda")],
)
def test_readers_find_masses_joints_colliders_and_places(reader, suffix, folder, cabinet):
    read = READERS[reader][0](str(folder / f"object.{suffix}"))
    assert compare(cabinet, read) == []


def test_a_difference_is_told(folder, cabinet):
    read = READERS["mujoco"][0](str(folder / "object.xml"))
    read["links"]["cabinet-drawer"][2] += 0.002
    read |= {"mass": read["mass"] * 1.01, "joints": 4, "shapes": 3}
    told = " ".join(compare(cabinet, read))
    assert all(word in told for word in ("mass", "4 joints", "3 colliders", "drawer 2 mm"))
    assert compare(cabinet, {"error": "no"}) == ["no"]


def test_an_object_moves_in_mujoco_from_urdf_as_from_mjcf(folder, cabinet):
    options = {"low": 0.0, "seconds": 0.2, "joint": "slide", "force": 3.0}
    mover = MOVERS["mujoco"][0]
    pulled = [mover(str(folder / file), options)["q"] for file in ("object.xml", "object.urdf")]
    # URDF has no stiffness, which holds the drawer back by 2 N/m.
    assert pulled[0] > 0.01 and pulled[1] == pytest.approx(pulled[0], rel=0.1)


def test_a_motion_that_is_not_the_same_is_told():
    mujoco = {"rest_mm": 0.1, "rest_degrees": 0.0, "pulled": 0.1, "expected": 0.1, "note": ""}
    assert within(mujoco, mujoco)
    for change in (
        {"rest_mm": 6.0}, {"rest_degrees": 3.0}, {"pulled": 0.12}, {"note": "it breaks down"},
    ):  # fmt: skip
        assert not within({**mujoco, **change}, mujoco), change
    # What has no dry friction is held against MuJoCo without it.
    assert within({**mujoco, "pulled": 0.2, "expected": 0.2}, mujoco)
