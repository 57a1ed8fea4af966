"""`neoworld check` on outside files: verdicts, and one clear message for broken files."""

import json
import xml.etree.ElementTree as ET

import pytest

from neoworld_mjx import cli
from neoworld_mjx.export import export_object
from tests.support import furniture as objects

LINK = (
    '<link name="{0}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
)
JOINT = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{2}"/></joint>'


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def checked(capfd):
    """Run the command in this process; return its exit code, output and error output."""

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            cli.main(["check", *map(str, words), "--json"])
        message = capfd.readouterr()
        return ended.value.code, json.loads(message.out), message.err

    return run


MESH = (
    '<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual>'
    "</link></robot>"
)
# tests/outside/test_hostile_files.py has many more, read without a command.
BROKEN = {
    "truncated.urdf": ('<robot name="r"><link name="a">', "is not valid XML"),
    "missing.urdf": (MESH.format("meshes/no.obj"), "which does not exist"),
    "cycle.urdf": (
        '<robot name="r">'
        + "".join(LINK.format(n) for n in "abc")
        + JOINT.format("j", "b", "c")
        + JOINT.format("k", "c", "b")
        + "</robot>",
        "form a cycle",
    ),
    "refused.xml": ("<mujoco><wonder/></mujoco>", "is refused by MuJoCo"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_exits_2_with_one_message(checked, tmp_path, name):
    text, message = BROKEN[name]
    (tmp_path / name).write_text(text)
    code, answer, err = checked(tmp_path / name)
    assert code == 2
    assert list(answer) == ["error"]
    assert name in answer["error"]
    assert message.lower() in answer["error"].lower()
    assert err.count("error:") == 1
    assert "Traceback" not in err
    assert "\n" not in answer["error"]


@pytest.mark.parametrize("file", ["object.urdf", "object.xml"])
def test_a_valid_asset_passes_and_an_invalid_one_fails_with_its_fault(checked, tmp_path, file):
    export_object(objects.cupboard(), tmp_path / "good")
    code, answer, _ = checked(tmp_path / "good" / file)
    assert (code, answer["passed"], answer["faults"]) == (0, True, [])
    export_object(objects.cupboard(lower=-0.4), tmp_path / "bad")
    code, answer, _ = checked(tmp_path / "bad" / file)
    assert (code, answer["cause"]) == (1, "limit_into_part")
    worst = answer["checks"][0]
    assert worst["outcome"] == "FAIL"
    assert worst["joint"].endswith("hinge")
    assert worst["value"] > worst["threshold"]
    assert worst["hint"]


PROGRAM = """from neoworld_mjx.program.sdk import Object, box, hollow_box
o = Object("crate")
body = o.part("body", material="oak")
shell = body.add(hollow_box((0.3, 0.4, 0.5), 0.018, open="+x"), by="bottom")
door = o.part("door", material="oak")
door.add(box((0.018, 0.4, 0.5)), at=(shell.anchor("front")[0] + 0.0005, 0, 0), by="back.bottom")
o.revolute("hinge", body, door, at="left.hinge", range=(0, 1.5), damping=0, friction=0)
"""


def test_a_patch_is_stored_next_to_its_program_and_survives_a_rebuild(checked, tmp_path, capfd):
    program = tmp_path / "crate.py"
    program.write_text(PROGRAM)
    code, answer, _ = checked(program)
    assert (code, answer["cause"]) == (1, "joint_undamped")
    code, answer, _ = checked(program, "--repair")
    assert code == 0
    assert answer["repair"]["before"] == ["joint_undamped"]
    assert (tmp_path / "crate.patch.json").is_file()
    # The program changes, and its patch holds.
    program.write_text(program.read_text().replace("0.4, 0.5", "0.4, 0.4"))
    code, answer, _ = checked(program)
    assert code == 0, answer["faults"]
    with pytest.raises(SystemExit) as ended:
        cli.main(["export", str(program), "--out", str(tmp_path / "out"), "--format", "urdf"])
    assert ended.value.code == 0, capfd.readouterr().err
    (dynamics,) = ET.parse(tmp_path / "out" / "object.urdf").getroot().iter("dynamics")
    assert float(dynamics.get("damping")) > 0
