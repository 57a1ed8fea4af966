"""Import of URDF and MJCF: assumptions, and notes of what is left out."""

import json

import pytest

from neoworld_mjx.cli import main
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export import read_mjcf
from neoworld_mjx.export.importing import import_file, import_object
from neoworld_mjx.physics import decompose
from neoworld_mjx.spec import Mesh

U = (
    "v 0 0 0\nv 3 0 0\nv 3 0 2\nv 2 0 2\nv 2 0 1\nv 1 0 1\nv 1 0 2\nv 0 0 2\n"
    "v 0 1 0\nv 3 1 0\nv 3 1 2\nv 2 1 2\nv 2 1 1\nv 1 1 1\nv 1 1 2\nv 0 1 2\n"
    "f 1 2 5\nf 1 5 6\nf 2 3 4\nf 2 4 5\nf 1 6 7\nf 1 7 8\n"
    "f 9 13 10\nf 9 14 13\nf 10 12 11\nf 10 13 12\nf 9 15 14\nf 9 16 15\n"
    + "".join(
        f"f {a} {a + 8} {b + 8}\nf {a} {b + 8} {b}\n"
        for a, b in [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 7), (7, 8), (8, 1)]
    )
)
"""A block with a slot, as OBJ."""


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))


def urdf(*content):
    return f'<robot name="r-2 d2">{"".join(content)}</robot>'


BOX = "<collision><geometry><box size='0.2 0.2 0.2'/></geometry></collision>"


def test_notes_list_omissions_and_assumptions(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(
        urdf(
            "<link name='world'/>",
            f"<link name='base-link'>{BOX}</link>",
            f"<link name='1arm'>{BOX}</link>",
            "<link name='tip'/>",
            "<joint name='w' type='fixed'><parent link='world'/><child link='base-link'/>"
            "<origin xyz='0 0 1'/></joint>",
            "<joint name='j' type='floating'><parent link='base-link'/>"
            "<child link='1arm'/></joint>",
            "<joint name='k' type='revolute'><parent link='1arm'/><child link='tip'/>"
            "<axis xyz='0 0 1'/>"
            "<limit lower='0' upper='1' effort='1' velocity='1'/></joint>",
            "<transmission name='t'/>",
        )
    )
    result = import_file(path)
    # The world has no geometry and is the base; the tip moves by itself and gets a ball.
    assert [p.name for p in result.spec.parts] == ["base_link", "p_1arm", "tip"]
    assert result.spec.root == "base_link"
    reported = " / ".join(result.notes)
    for message in (
        "transmissions",
        "floating: imported as fixed",
        "no mass",
        "tip has no geometry",
    ):
        assert message in reported


def test_notes_of_a_scene_name_the_object_unless_they_concern_the_whole_file(tmp_path):
    box = "<geom size='0.1 0.1 0.1' type='box'/>"
    file = tmp_path / "two.xml"
    file.write_text(
        f"<mujoco><worldbody><body name='crate'><joint name='spin'/>{box}</body>"
        f"<body name='joint_block' pos='1 0 0'><freejoint/>{box}</body></worldbody>"
        "<equality><weld body1='crate' body2='joint_block'/></equality>"
        "<sensor><jointpos joint='spin'/></sensor></mujoco>"
    )
    assert set(import_file(file).notes) == {
        "1 sensor not imported",
        "equality (weld of crate and joint_block) is not imported",
    }


def test_an_object_on_a_floor_is_checked_as_a_scene_or_by_itself(tmp_path, capfd):
    path = tmp_path / "cup.xml"
    path.write_text(
        "<mujoco><worldbody><geom name='ground' type='plane' size='1 1 1'/><body name='cup' "
        "pos='0 0 .1'><freejoint/><geom type='box' size='.1 .1 .1'/></body></worldbody></mujoco>"
    )
    for flags, entry in (((), "movable"), (("--repair",), "object")):
        with pytest.raises(SystemExit) as left:
            main(["check", str(path), "--json", *flags])
        answer = json.loads(capfd.readouterr().out)
        assert left.value.code == 0 and entry in answer
    assert "only cup is used, without its surroundings: ground" in answer["notes"]
    assert import_object(path).spec.name == "cup"


def test_meshes_without_colliders_are_decomposed_and_cached(tmp_path, monkeypatch):
    pytest.importorskip("coacd")
    (tmp_path / "u.obj").write_text(U)
    path = tmp_path / "u.urdf"
    path.write_text(
        urdf("<link name='u'><visual><geometry><mesh filename='u.obj'/></geometry></visual></link>")
    )
    result = import_file(path)
    (geom,) = result.spec.parts[0].geoms
    assert isinstance(geom.shape, Mesh)
    assert geom.role == "both"
    assert len(geom.shape.hulls) >= 3  # two posts and what joins them
    assert len(geom.shape.surface()[1]) == 28
    assert any("no colliders" in note for note in result.notes)
    monkeypatch.setattr(decompose, "call_limited", lambda *_, **__: pytest.fail("it was kept"))
    assert import_file(path).spec == result.spec


def test_a_file_of_several_objects_is_refused_with_their_names(tmp_path):
    path = tmp_path / "two.xml"
    body = "<body name='{}'><geom size='0.1'/></body>"
    path.write_text(f"<mujoco><worldbody>{body.format('a')}{body.format('b')}</worldbody></mujoco>")
    with pytest.raises(SpecError, match="a, b"):
        read_mjcf(path)


STOVE = """<mujoco><compiler boundmass="0.001" boundinertia="1e-6"/><worldbody><body name="stove">
<geom type="box" size=".3 .3 .4" pos="0 0 .4" density="300"/>
<body name="burner" pos="0 0 .81">
<geom type="cylinder" size=".1 .01" contype="0" conaffinity="0" mass="0"/>
</body>
<body name="knob" pos=".31 0 .7"><joint axis="1 0 0" range="0 90" limited="true"/>
<geom type="box" size=".02 .02 .02" contype="0" conaffinity="0" mass="0.1"/></body>
</body></worldbody></mujoco>"""


def test_visual_links_merge_with_the_link_they_are_fixed_to(tmp_path):
    path = tmp_path / "stove.xml"
    path.write_text(STOVE)
    result = import_file(path)
    assert [part.name for part in result.spec.parts] == ["stove", "knob"]
    assert [geom.role for geom in result.spec.part("stove").geoms] == ["collision", "visual"]
    # The burner weighs as much as the compiler's lower bound of a mass.
    assert result.spec.part("stove").mass == pytest.approx(300 * 0.6 * 0.6 * 0.8 + 0.001, abs=1e-9)
    # The knob collides with nothing, so only a tiny sphere is its collider.
    assert [geom.role for geom in result.spec.part("knob").geoms] == ["visual", "collision"]
    assert result.spec.part("knob").mass == pytest.approx(0.1)
