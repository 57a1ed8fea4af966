"""Imported MJCF and URDF against the model that MuJoCo compiles from the same file."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing import ImportedScene, import_file
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.spec import SceneSpec

BOX = "<geom type='box' size='.1 .1 .1'/>"
FREE = "<body name='{}' pos='{}'><freejoint/>" + BOX + "</body>"
FLOOR = "<geom type='plane' size='2 2 .1'/>"
DOOR = (
    "<body name='door' pos='0 .06 1' euler='0 0 20'><joint name='hinge' axis='0 0 1' range='0 90'/>"
    "<geom type='box' size='.02 .4 .95' pos='0 .42 0' mass='15'/></body>"
)

MJCF = {
    "floor": f"{FLOOR}{FREE.format('a', '0 0 .1')}{FREE.format('b', '.5 0 .1')}",
    "tilted plane": f"<geom type='plane' size='0 0 .1' euler='10 0 0'/>{FREE.format('a', '0 0 1')}",
    "table of world geoms": "<geom name='top' type='box' size='.4 .4 .02' pos='0 0 .5'/>"
    "<geom type='cylinder' size='.03' fromto='.3 .3 0 .3 .3 .48'/>" + FREE.format("cup", "0 0 .62"),
    "door on the world": f"<geom type='box' size='.02 .05 1' pos='0 0 1'/>{DOOR}",
    "door alone": DOOR,
    "gantry on the world": "<body name='t'><joint type='slide' axis='1 0 0' range='-1 1'/>"
    f"<joint type='slide' axis='0 1 0'/><joint axis='0 0 1'/>{BOX}</body>",
    "ball on the world": "<body name='p' pos='0 0 1'><joint type='ball' range='0 60'/>"
    f"{BOX}</body>",
    "arm on a fixed base": f"<body name='b' pos='.2 0 .1'>{BOX}<body name='l' pos='0 0 .2'>"
    f"<joint name='j' axis='0 1 0' range='-30 60'/>{BOX}<body pos='0 0 .25'>{BOX}"
    f"<body pos='.3 0 0' euler='0 0 30'><joint type='slide' axis='1 0 0' range='0 .2'/>{BOX}"
    "</body></body></body></body>",
    "robot on wheels": "<body name='r' pos='0 0 .3'><freejoint/><geom type='box' size='.3 .2 .1'/>"
    "<body pos='.2 .25 -.1'><joint axis='0 1 0' damping='.1'/>"
    "<geom type='cylinder' size='.1 .02' euler='90 0 0'/></body></body>",
    "classes and frames": "<frame pos='1 0 0' euler='0 0 45'><body name='a' childclass='c'>"
    "<freejoint/><geom/><frame euler='90 0 0'><body pos='0 0 .3'><joint/><geom mass='3'/></body>"
    "</frame></body></frame>",
    "markers": f"<body name='m' mocap='true'><geom size='.02' contype='0' conaffinity='0'/></body>"
    f"{FREE.format('b', '0 0 .1')}",
    "visual link that moves": f"<body name='s'>{BOX}<body name='k' pos='.15 0 0'>"
    "<joint axis='1 0 0' range='0 90'/><geom size='.02' contype='0' conaffinity='0' mass='.2'/>"
    "</body></body>",
    "masses without geoms": "<body name='s'><freejoint/><geom type='box' size='.1 .1 .1'/>"
    "<body pos='0 0 .05'><inertial pos='0 0 0' mass='25' diaginertia='.4 .4 .6'/></body></body>",
    "stated inertia": "<body name='s'><freejoint/><inertial pos='.02 0 0' quat='1 .2 0 0' mass='3' "
    "diaginertia='.03 .02 .04'/><geom type='box' size='.1 .1 .1'/></body>",
    "several joints of a body": f"<body name='s'>{BOX}<body name='u' pos='0 0 .2'>"
    f"<joint axis='1 0 0' range='-45 45'/><joint axis='0 1 0' range='-30 30'/>{BOX}</body></body>",
    "names that clash": f"<body name='box'>{BOX}<body name='lid' pos='0 0 .3'>"
    f"<joint axis='0 1 0' range='0 90'/>{BOX}<body name='knob' pos='0 0 .3'>"
    f"<joint name='lid_joint' axis='0 0 1' range='-45 45'/>{BOX}<body pos='0 0 .3'>{BOX}</body>"
    "</body></body></body>",
    "reference and spring": f"<body name='a'>{BOX}<body pos='.3 0 0'><joint axis='0 0 1' ref='20' "
    f"range='-10 50' stiffness='3' springref='10'/>{BOX}</body></body>",
    "colors": "<body name='a'><freejoint/><geom type='box' size='.1 .1 .1' material='red'/>"
    "<geom size='.05' pos='0 0 .2' rgba='.1 .2 .9 .5' contype='0' conaffinity='0'/></body>",
}
"""Contents of <worldbody>, by kind of file."""
SECTIONS = {
    "classes and frames": "<default><default class='c'><geom type='capsule' size='.05 .1' "
    "density='500'/><joint axis='0 1 0' range='-20 20' damping='.3'/></default></default>",
    "colors": "<asset><material name='red' rgba='.9 .1 .1 1'/></asset>",
    "floor": "<option gravity='0 0 -1.62'/>",
}


def solid(model: mujoco.MjModel) -> np.ndarray:
    """Return the colliding geoms that are neither planes, their boxes, nor placeholders."""
    size = np.max(model.geom_size, axis=1)
    plane = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) | (size >= 5)
    return np.flatnonzero((model.geom_contype > 0) & ~plane & (size > 2e-3))


def facts(model: mujoco.MjModel) -> dict[str, np.ndarray | float]:
    """Return mass, joints, colliders and gravity, independent of names, order and frames."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moving = (model.body_weldid != 0) & (model.body_mocapid[model.body_rootid] < 0)
    joints = []
    for j in range(model.njnt):
        kind, low, high = int(model.jnt_type[j]), *model.jnt_range[j]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            joints.append([kind, *np.zeros(8)])
            continue
        ref = model.qpos0[model.jnt_qposadr[j]] if kind != mujoco.mjtJoint.mjJNT_BALL else 0.0
        limits = [low - ref, high - ref] if model.jnt_limited[j] else [0.0, 0.0]
        axis = data.xaxis[j] if kind != mujoco.mjtJoint.mjJNT_BALL else np.zeros(3)
        joints.append([kind, *limits, *data.xanchor[j], *axis])
    chosen = solid(model)
    geoms = np.column_stack(
        [model.geom_type[chosen], data.geom_xpos[chosen], model.geom_size[chosen]]
    )
    com = (model.body_mass[moving] @ data.xipos[moving]) / max(model.body_mass[moving].sum(), 1e-9)
    return {
        "mass": float(model.body_mass[moving].sum()),
        "com": com,
        "joints": rows(joints, 9),
        "geoms": rows(geoms, 7),
        "gravity": np.array(model.opt.gravity),
    }


def rows(values, width: int) -> np.ndarray:
    """Return rows in an order that depends only on their values."""
    array = np.round(np.reshape(np.array(values, float), (-1, width)), 6) + 0.0
    return array[np.lexsort(array.T[::-1])]


def own_model(path: Path) -> tuple[mujoco.MjModel, tuple[str, ...], SceneSpec]:
    read = import_file(path)
    scene = read.spec if isinstance(read, ImportedScene) else read.scene
    return to_mjspec(scene).compile(), read.notes, scene


@pytest.mark.parametrize("kind", MJCF)
def test_mjcf_has_the_mass_joints_colliders_and_gravity_of_the_compiled_model(tmp_path, kind):
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco>{SECTIONS.get(kind, '')}<worldbody>{MJCF[kind]}</worldbody></mujoco>")
    reference = mujoco.MjModel.from_xml_path(str(path))
    own, notes, scene = own_model(path)
    expected, actual = facts(reference), facts(own)
    if kind == "gantry on the world":  # Slides need limits.
        assert any("slides without limits: here from -10 to 10 m" in note for note in notes)
        unlimited = (actual["joints"][:, 0] == 2) & (actual["joints"][:, 2] == 10)
        assert unlimited.sum() == 1
        actual["joints"][unlimited, 1:3] = 0
        actual["joints"] = rows(actual["joints"], 9)
    for name, value in expected.items():
        assert np.allclose(actual[name], value, atol=2e-5), name
    colors = {tuple(m.rgba) for item in scene.objects for m in item.spec.materials}
    # As in MuJoCo's renderer, a geom's own color precedes that of its material.
    plain = (reference.geom_rgba == np.float32([0.5, 0.5, 0.5, 1])).all(axis=1)
    used = np.where(
        (plain & (reference.geom_matid >= 0))[:, None],
        reference.mat_rgba[reference.geom_matid] if reference.nmat else reference.geom_rgba,
        reference.geom_rgba,
    )
    shown = {
        tuple(np.round(row.astype(float), 4).tolist()) for row in used[reference.geom_bodyid > 0]
    }
    if kind != "markers":
        assert shown <= {tuple(np.round(color, 4).tolist()) for color in colors}


LOSSES = {
    "gravity of an object": (
        f"<option gravity='0 0 -1.62'/><worldbody>{FREE.format('a', '0 0 0')}</worldbody>",
        "gravity 0 0 -1.62 m/s^2 is not kept",
    ),
    "disabled gravity": (
        "<option><flag gravity='disable'/></option>"
        f"<worldbody>{FREE.format('a', '0 0 0')}</worldbody>",
        "gravity 0 0 0 m/s^2 is not kept",
    ),
    "inactive equality": (
        f"<worldbody><body>{BOX}<body pos='0 0 .3'><joint name='j'/>{BOX}</body><body "
        f"pos='0 0 -.3'><joint name='k'/>{BOX}</body></body></worldbody><equality><joint "
        "name='e' joint1='j' joint2='k' active='false'/></equality>",
        "equality e (joint of j and k) is inactive: not imported",
    ),
    "weld": (
        f"<worldbody>{FREE.format('a', '0 0 0')}{FREE.format('b', '1 0 0')}</worldbody>"
        "<equality><weld name='w' body1='a' body2='b'/></equality>",
        "equality w (weld of a and b) is not imported",
    ),
    "lock": (
        f"<worldbody><body>{BOX}<body pos='0 0 .3'><joint name='j'/>{BOX}</body></body>"
        "</worldbody><equality><joint joint1='j' polycoef='.3 0 0 0 0'/></equality>",
        "equality (joint of j), which holds it at 0.3, is not imported",
    ),
    "equality of two objects": (
        f"<worldbody><body name='a'>{BOX}<body pos='0 0 .3'><joint name='j'/>{BOX}</body></body>"
        f"<body name='b' pos='1 0 0'>{BOX}<body pos='0 0 .3'><joint name='k'/>{BOX}</body></body>"
        "</worldbody><equality><joint joint1='j' joint2='k'/></equality>",
        "equality (joint of j and k), which are joints of two objects, is not imported",
    ),
    "marker": (
        "<worldbody><body name='m' mocap='true'><geom size='.02' contype='0' conaffinity='0'/>"
        f"</body>{FREE.format('a', '0 0 0')}</worldbody>",
        "body m (0.0335103 kg) collides with nothing: not imported",
    ),
    "mocap": (
        f"<worldbody><body name='m' mocap='true'>{BOX}</body>{FREE.format('a', '0 0 1')}"
        "</worldbody>",
        "m: a mocap body moves only as a program prescribes: here it is fixed",
    ),
    "plane": (
        f"<worldbody><geom name='ground' type='plane' size='1 1 1'/>{FREE.format('a', '0 0 1')}"
        "</worldbody>",
        "plane ground is infinite: here it is a box of 10 x 10 x 0.1 m",
    ),
    "excluded pair": (
        f"<worldbody>{FREE.format('a', '0 0 0')}{FREE.format('b', '1 0 0')}</worldbody>"
        "<contact><exclude body1='a' body2='b'/></contact>",
        "bodies a and b never collide in the file: here they may",
    ),
    "contact masks": (
        "<worldbody><body><freejoint/><geom size='.1' contype='1' conaffinity='2'/></body>"
        "<body pos='1 0 0'><freejoint/><geom size='.1' contype='1' conaffinity='2'/></body>"
        "<body pos='2 0 0'><freejoint/><geom size='.1' contype='2' conaffinity='1'/></body>"
        "</worldbody>",
        "contype and conaffinity keep 1 pairs of geoms apart: here they collide",
    ),
    "condim": (
        "<worldbody><body><freejoint/><geom size='.1' condim='6' margin='.01'/></body></worldbody>",
        "condim 6 of 1 geoms is not kept",
    ),
    "wind": (
        f"<option wind='1 0 0' density='1.2'/><worldbody>{FREE.format('a', '0 0 0')}</worldbody>",
        "density 1.2 kg/m^3 is not kept",
    ),
    "spring": (
        f"<worldbody><body>{BOX}<body pos='0 0 .3'><joint name='j' stiffness='2' springref='30'/>"
        f"{BOX}</body></body></worldbody>",
        "joint j: the rest position 0.523599 of its spring is not kept, it is 0",
    ),
    "actuators": (
        f"<worldbody><body>{BOX}<body pos='0 0 .3'><joint name='j'/>{BOX}</body></body>"
        "</worldbody><actuator><motor name='m' joint='j'/></actuator>",
        "1 actuator (m) not imported",
    ),
    "gravity compensation": (
        f"<worldbody><body name='a' gravcomp='1'><freejoint/>{BOX}</body></worldbody>",
        "body a: gravcomp 1 is not kept",
    ),
    "no joint": (f"<worldbody><body>{BOX}</body></worldbody>", "no joint lets the object move"),
    "fixed base": (
        f"<worldbody><body pos='1 0 .5'>{BOX}<body pos='0 0 .3'><joint/>{BOX}</body></body>"
        "</worldbody>",
        "the base is fixed to the world at (1, 0, 0.4) m",
    ),
}


@pytest.mark.parametrize("kind", LOSSES)
def test_what_objects_cannot_hold_is_noted_with_its_value(tmp_path, kind):
    content, note = LOSSES[kind]
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco>{content}</mujoco>")
    notes = import_file(path).notes
    assert any(note in line for line in notes), notes


def inertial(mass: float, at: str = "0 0 0") -> str:
    moment = 0.02 * mass
    return (
        f"<inertial><origin xyz='{at}' rpy='.3 0 0'/><mass value='{mass}'/><inertia ixx='{moment}'"
        f" iyy='{moment}' izz='{1.5 * moment}' ixy='0' ixz='0' iyz='0'/></inertial>"
    )


def link(name: str, mass: float = 1.0, shape: str = "<box size='.2 .2 .2'/>") -> str:
    both = "".join(
        f"<{tag}><origin xyz='0 0 .1'/><geometry>{shape}</geometry></{tag}>"
        for tag in ("visual", "collision")
    )
    return f"<link name='{name}'>{inertial(mass, '0 0 .1') if mass else ''}{both}</link>"


def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    return (
        f"<joint name='{name}' type='{kind}'><origin xyz='.1 0 .3' rpy='0 .2 0'/>"
        f"<parent link='{parent}'/><child link='{child}'/><axis xyz='0 1 0'/>{more}</joint>"
    )


LIMIT = "<limit lower='-.4' upper='1.2' effort='5' velocity='1'/>"
URDF = {
    "hinge": link("a", 5) + link("b", 2) + joint("j", "revolute", "a", "b", LIMIT),
    "slide and wheel": link("a", 5)
    + link("b")
    + link("c", 3)
    + joint("j", "prismatic", "a", "b", LIMIT)
    + joint("k", "continuous", "b", "c"),
    "ballast": link("a", 5)
    + f"<link name='ballast'>{inertial(25)}</link>"
    + joint("j", "fixed", "a", "ballast")
    + link("b")
    + joint("k", "revolute", "ballast", "b", LIMIT),
    "chain of fixed links": link("a", 5)
    + link("b", 2)
    + link("c", 1)
    + joint("j", "fixed", "a", "b")
    + joint("k", "fixed", "b", "c"),
    "world": "<link name='world'/>"
    + link("a", 5)
    + link("b", 2)
    + joint("w", "fixed", "world", "a")
    + joint("j", "revolute", "a", "b", LIMIT),
    "hinge on the world": "<link name='world'/>"
    + link("a", 5)
    + joint("j", "revolute", "world", "a", LIMIT),
    "planar": link("a", 5) + link("b", 2) + joint("j", "planar", "a", "b"),
    "floating from the world": "<link name='world'/>"
    + link("a", 5)
    + joint("w", "floating", "world", "a"),
    "visual link": link("a", 5)
    + "<link name='b'><visual><geometry><box size='.1 .1 .1'/></geometry></visual></link>"
    + joint("j", "fixed", "a", "b"),
    "sphere, cylinder and capsule": link("a", 5, "<sphere radius='.1'/>")
    + link("b", 2, "<cylinder radius='.05' length='.3'/>")
    + link("c", 2, "<capsule radius='.05' length='.3'/>")
    + joint("j", "revolute", "a", "b", LIMIT)
    + joint("k", "revolute", "b", "c", LIMIT),
}


@pytest.mark.parametrize("kind", URDF)
def test_urdf_has_the_mass_joints_and_colliders_that_mujoco_reads(tmp_path, kind):
    path = tmp_path / "a.urdf"
    path.write_text(f"<robot name='r'>{URDF[kind]}</robot>")
    reference = mujoco.MjSpec.from_file(str(path))
    reference.compiler.fusestatic = False
    model = reference.compile()
    read = import_file(path)
    own = to_mjspec(read.scene).compile()
    assert own.body_mass.sum() == pytest.approx(model.body_mass.sum(), rel=1e-5)
    assert read.fixed_base == (kind in ("world", "hinge on the world"))
    expected, actual = (facts(m) for m in (model, own))
    if kind == "planar":  # Slides have limits, and the axes in the plane are arbitrary.
        assert "joint j is planar: imported as two slides of 10 m and a hinge" in read.notes
        for value in (expected, actual):
            value["joints"] = rows(value["joints"][:, [0, 3, 4, 5]], 4)
    joints = actual["joints"][actual["joints"][:, 0] != 0]
    other = expected["joints"][expected["joints"][:, 0] != 0]
    assert np.allclose(joints, other, atol=1e-5)
    assert np.allclose(actual["geoms"], expected["geoms"], atol=1e-5)
    assert not read.notes or read.fixed_base or kind in ("ballast", "planar")


@pytest.mark.parametrize("moments", [(0.001, 0.001, 0.1), (0, 0, 0), (-0.001, 0.01, 0.01)])
def test_an_inertia_that_no_body_has_is_one_line_for_export(tmp_path, moments):
    a, b, c = moments
    bad = (
        f"<inertial><mass value='1'/><inertia ixx='{a}' iyy='{b}' izz='{c}' ixy='0' ixz='0' "
        "iyz='0'/></inertial><collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
    )
    path = tmp_path / "a.urdf"
    path.write_text(f"<robot name='r'><link name='base'>{bad}</link></robot>")
    read = import_file(path)
    line = "part base states an inertia that no body has"
    assert any(line in note for note in read.notes)
    with pytest.raises(SpecError, match=f"{line}.*--repair"):
        to_mjspec(read.spec)
