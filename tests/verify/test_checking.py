"""`neoworld check` on outside files: verdicts, and one clear message for broken files."""

import json

import pytest

from neoworld_mjx import cli
from neoworld_mjx.export import export_object
from tests.support import furniture as objects

CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4\nf 1 4 3\nf 5 7 8\nf 5 8 6\nf 1 5 6\nf 1 6 2\nf 3 4 8\nf 3 8 7\nf 1 3 7\nf 1 7 5\n"
    "f 2 6 8\nf 2 8 4\n"
)
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


def deep(levels):
    inner = '<geom size="0.1"/>'
    for k in range(levels):
        inner = f'<body name="b{k}">{inner}</body>'
    return f"<mujoco><worldbody>{inner}</worldbody></mujoco>"


MESH = (
    '<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual>'
    "</link></robot>"
)
BROKEN = {
    "truncated.urdf": ('<robot name="r"><link name="a">', "is not valid XML"),
    "truncated.xml": ('<mujoco><worldbody><body name="a"', "is not valid XML"),
    "empty.urdf": ("", "is not valid XML"),
    "missing.urdf": (MESH.format("meshes/no.obj"), "which does not exist"),
    "missing.xml": (
        '<mujoco><asset><mesh name="m" file="no.obj"/></asset><worldbody><body>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        "which does not exist",
    ),
    "nan.urdf": (
        '<robot name="r"><link name="a"><collision><origin xyz="0 nan 0"/><geometry>'
        '<sphere radius="1"/></geometry></collision></link></robot>',
        "is not a finite number",
    ),
    "nan.xml": (
        '<mujoco><worldbody><body pos="0 0 inf"><geom size="0.1"/></body></worldbody></mujoco>',
        "is not a finite number",
    ),
    "cycle.urdf": (
        '<robot name="r">'
        + "".join(LINK.format(n) for n in "abc")
        + JOINT.format("j", "b", "c")
        + JOINT.format("k", "c", "b")
        + "</robot>",
        "form a cycle",
    ),
    "two_roots.urdf": (
        '<robot name="r">' + LINK.format("a") + LINK.format("b") + "</robot>",
        "one root link",
    ),
    "nested.xml": (deep(120), "nested more than 100"),
    "outside.urdf": (MESH.format("../secret.obj"), "lies outside its folder"),
    "outside.xml": (
        '<mujoco><include file="../secret.xml"/><worldbody/></mujoco>',
        "lies outside its folder",
    ),
    "meshdir.xml": (
        '<mujoco><compiler meshdir=".."/><asset><mesh name="m" file="secret.obj"/></asset>'
        '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        "lies outside its folder",
    ),
    "itself.xml": ('<mujoco><include file="itself.xml"/></mujoco>', "includes itself"),
    "laughs.urdf": (
        '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"/>',
        "declares a document type or entities",
    ),
    "laughs.xml": (
        '<!DOCTYPE m SYSTEM "file:///etc/passwd"><mujoco/>',
        "declares a document type or entities",
    ),
    "html.xml": ("<html/>", "the root element is <html>"),
    "refused.xml": ("<mujoco><wonder/></mujoco>", "is refused by MuJoCo"),
    "flipped.urdf": (
        '<robot name="r">' + LINK.format("a") + LINK.format("b")
        + '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
        '<limit lower="1" upper="0" effort="1" velocity="1"/></joint></robot>',
        "lower 1 is above upper 0",
    ),
    "overflow.urdf": (
        '<robot name="r"><link name="a"><collision><origin xyz="1e400 0 0"/><geometry>'
        '<sphere radius="1"/></geometry></collision></link></robot>',
        "is not a finite number",
    ),
    "vast.xml": (
        '<mujoco><worldbody><body><geom size="1e200"/></body></worldbody></mujoco>',
        "should be a finite number",
    ),
    "follow.urdf": (
        '<robot name="r">' + "".join(LINK.format(n) for n in "abc")
        + "".join(
            f'<joint name="{j}" type="revolute"><parent link="a"/><child link="{c}"/>'
            '<axis xyz="0 0 1"/>'
            f'<limit lower="0" upper="1" effort="1" velocity="1"/><mimic joint="{k}"/></joint>'
            for j, c, k in (("j", "b", "k"), ("k", "c", "j"))
        ) + "</robot>",
        "mimics itself through other joints",
    ),
    "bad_mesh.urdf": (MESH.format("in.obj"), "has no triangles"),
    "cup.usda": ("#usda 1.0", "USD is written, not read; convert it to MJCF, URDF or glTF"),
    "robot.xacro": ('<robot name="r" xmlns:xacro="x"><xacro:macro name="m"/></robot>', "xacro"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_exits_2_with_one_message(checked, tmp_path, name):
    text, message = BROKEN[name]
    (tmp_path / "secret.obj").write_text(CUBE)
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    home = tmp_path / "in"
    home.mkdir()
    (home / "in.obj").write_text("hello")
    (home / name).write_text(text)
    code, answer, err = checked(home / name)
    assert code == 2
    assert list(answer) == ["error"]
    assert name in answer["error"]
    assert message.lower() in answer["error"].lower()
    assert err.count("error:") == 1
    assert "Traceback" not in err
    assert "\n" not in answer["error"]


def test_a_missing_file_exits_2(checked, tmp_path):
    code, answer, _ = checked(tmp_path / "no.urdf")
    assert code == 2
    assert "cannot read" in answer["error"]


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
        cli.main(["build", str(program), "--out", str(tmp_path / "out"), "--json"])
    built = json.loads(capfd.readouterr().out)
    assert ended.value.code == 0
    assert any("damping" in change for change in built["overlay"]["changes"])
    spec = json.loads((tmp_path / "out" / "spec.json").read_text())
    assert spec["joints"][0]["damping"] > 0


def test_the_repaired_object_is_written_to_the_given_folder(checked, tmp_path):
    export_object(objects.cupboard(damping=0.0, friction=0.0), tmp_path / "in")
    code, _, _ = checked(tmp_path / "in" / "object.xml", "--repair", "--out", tmp_path / "out")
    assert code == 0
    assert 'damping="' in (tmp_path / "out" / "object.xml").read_text()
    assert checked(tmp_path / "out" / "object.xml")[0] == 0
    assert checked(tmp_path / "in" / "object.xml", "--out", tmp_path / "x")[0] == 2
