"""The programs of benchmarks/readers.py that are here, on an object with every joint and shape."""

import numpy as np
import pytest

from benchmarks.foreign import PROGRAMS, probe
from benchmarks.motion_probe import MOVERS, degrees
from benchmarks.pulls import pull_of
from benchmarks.reader_probe import READERS
from benchmarks.readers import apart, compare
from neoworld_mjx.export import export_object
from neoworld_mjx.spec import Box, ObjectSpec, inertial
from tests.support.mechanisms import WOOD, geom, joint, part


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cabinet):
    out = tmp_path_factory.mktemp("readers")
    export_object(cabinet, out)
    return out


@pytest.mark.parametrize(
    ("reader", "suffix"),
    [("mujoco", "xml"), ("mujoco", "urdf"), ("yourdfpy", "urdf"), ("usd", "usda")],
)
def test_readers_report_masses_joints_colliders_and_positions(reader, suffix, folder, cabinet):
    result = compare(cabinet, READERS[reader](str(folder / f"object.{suffix}")))
    assert set(result) >= {"masses", "joints", "colliders"}
    assert not any(result.values()), result
    assert ("places" in result) == (reader != "usd")


def test_differences_are_reported(folder, cabinet):
    read = READERS["mujoco"](str(folder / "object.xml"))
    read["links"]["cabinet-drawer"][2] += 0.002
    read |= {"mass": read["mass"] * 1.01, "joints": 4, "shapes": 3}
    told = compare(cabinet, read)
    assert "kg" in told["masses"] and "4 that move" in told["joints"]
    assert told["colliders"].startswith("3,") and "drawer 2 mm" in told["places"]


def test_jobs_run_in_a_child_process(folder):
    jobs = [{"read": str(folder / "object.urdf")}, {"read": str(folder / "no.urdf")}]
    version, (read, failed) = probe("yourdfpy", jobs)
    assert version and read["joints"] > 2 and "error" in failed
    here = [name for name, program in PROGRAMS.items() if not program.requirements]
    assert here == ["mujoco", "yourdfpy", "usd"]


def test_a_crash_is_reported_and_other_jobs_continue(folder, monkeypatch):
    import benchmarks.foreign as foreign

    file, runs = str(folder / "object.urdf"), []
    own = foreign._run

    def dies_once(program, jobs):
        runs.append(len(jobs))
        lines, _ = own(program, jobs)
        return (lines[:2], "ended with -11: ") if len(runs) == 1 else (lines, "")

    monkeypatch.setattr(foreign, "_run", dies_once)
    _, results = probe("yourdfpy", [{"read": file}] * 3)
    assert runs == [3, 1]
    assert ["error" in one for one in results] == [False, True, False]


def test_a_pull_moves_urdf_and_mjcf_alike(folder, cabinet):
    pull = pull_of(cabinet)
    joint = cabinet.joint(pull.joint)
    assert joint.type == "prismatic" and pull.link == joint.child
    # Along the axis, towards where it opens.
    assert np.allclose(np.cross(pull.force, joint.axis), 0) and np.dot(pull.force, joint.axis) > 0
    options = {"seconds": 0.2, **pull._asdict()}
    one, other = (
        MOVERS["mujoco"](str(folder / f), options)["q"] for f in ("object.xml", "object.urdf")
    )
    # URDF has no stiffness, which holds the drawer back.
    assert one > 0.003 and other == pytest.approx(one, rel=0.1)


def test_a_pull_opens_part_of_the_range_against_gravity(cabinet):
    assert pull_of(cabinet, dry=False) != pull_of(cabinet)
    lid = part("lid", geom("plate", Box(size=(0.4, 0.3, 0.02)), (0.2, 0, 0.31)))
    box = part("box", geom("body", Box(size=(0.4, 0.3, 0.3)), (0.2, 0, 0.15)))
    hinge = joint("hinge", "revolute", "box", "lid", axis=(0, -1, 0), pos=(0, 0, 0.3), upper=1.5)
    spec = ObjectSpec(name="chest", materials=(WOOD,), parts=(box, lid), joints=(hinge,))
    pull = pull_of(spec)
    mass = inertial(spec, lid).mass
    torque = float(np.cross(pull.offset, pull.force) @ np.array(hinge.axis))
    weight = mass * 9.81 * 0.2
    moment = mass * (0.4**2 + 0.02**2) / 12 + mass * (0.2**2 + 0.01**2)
    assert torque == pytest.approx(weight + 2.5 * moment + hinge.friction, rel=1e-3)


def test_differences_of_motion_are_reported():
    still = {"start": [0, 0, 0], "pos": [0, 0, 0], "quat": [1, 0, 0, 0]}
    tilted = [np.cos(np.radians(1.5)), np.sin(np.radians(1.5)), 0, 0]
    assert degrees(tilted) == pytest.approx(3.0)
    rest = {"roots": {"a": still}}
    assert apart(rest, rest) is None
    assert apart({"roots": {"b": {**still, "pos": [0.004, 0, 0]}}}, rest) is None
    for change in ({"pos": [0.006, 0, 0]}, {"quat": tilted}):
        assert "beside MuJoCo's" in apart({"roots": {"b": {**still, **change}}}, rest), change
    assert apart({"q": 0.108}, {"q": 0.1}) is None
    assert apart({"q": 0.112}, {"q": 0.1}) == "0.112, not 0.1"
    assert apart({"error": "it breaks down"}, rest) == "it breaks down"
