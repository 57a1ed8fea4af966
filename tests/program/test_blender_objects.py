"""What Blender's process writes, read back as an object, without Blender and without trust."""

import base64

import numpy as np
import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import ProgramError
from neoworld_mjx.physics.decompose import coacd_installed
from neoworld_mjx.program.assemble import assemble
from neoworld_mjx.program.blender import blender_process
from neoworld_mjx.program.blender.blender_objects import build_object
from neoworld_mjx.program.blender.blender_scene import BlenderScene, shape_of, split_solids
from neoworld_mjx.program.building import run
from neoworld_mjx.program.session import Session
from neoworld_mjx.spec import Box, inertial

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)
OAK = {"name": "dark_oak", "rgb": [0.3, 0.2, 0.1]}


def packed(values, kind):
    return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode()


def shape(name, size, at=(0, 0, 0), part=None, faces=FACES, vertices=None, **more):
    corners = CUBE * size + at if vertices is None else vertices
    return {
        "name": name,
        "part": part or name,
        "role": "both",
        "convex": False,
        "materials": ["dark_oak"],
        "vertices": packed(corners, "<f8"),
        "faces": packed(faces, "<i4"),
        "slots": packed(np.zeros(len(faces)), "<i4"),
        **more,
    }


def chest(**joint):
    shapes = [shape("body", (0.2, 0.3, 0.1)), shape("lid", (0.2, 0.3, 0.02), (0, 0, 0.06))]
    hinge = {"name": "hinge", "type": "revolute", "parent": "body", "child": "lid",
             "at": [-0.1, 0, 0.05000001], "axis": [0, -1, 0], "range": [0, 1.5]}  # fmt: skip
    hinge |= joint
    return {"name": "chest", "materials": [OAK], "shapes": shapes, "joints": [hinge]}


def read(scene, **options):
    session = Session(max_geoms=20)
    signals = build_object(BlenderScene.model_validate(scene), session, ProgramOptions(**options))
    if any(signal.severity == "error" for signal in signals):
        return None, signals
    spec, structure = assemble(session.objects)
    return spec, [*signals, *structure]


def test_parts_materials_and_joints_come_back():
    spec, signals = read(chest(opens=[0, 0, 1]))
    assert signals == []
    assert [part.name for part in spec.parts] == ["body", "lid"]
    assert all(isinstance(part.geoms[0].shape, Box) for part in spec.parts)
    (material,) = spec.materials
    assert (material.density, material.rgba) == (720, (0.3, 0.2, 0.1, 1.0))
    (hinge,) = spec.joints
    assert (hinge.parent, hinge.child, hinge.upper) == ("body", "lid", 1.5)
    # The origin is the middle of the bottom, and single precision's last digits are gone.
    np.testing.assert_allclose(hinge.pos, (-0.1, 0, 0.1), atol=1e-12)
    assert hinge.damping > 0
    assert inertial(spec, spec.part("lid")).mass == pytest.approx(720 * 0.2 * 0.3 * 0.02)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"type": "hinge"}, r'empty\["joint"\]: got \'hinge\', valid are: fixed, revolute'),
        ({"child": "lit"}, "did you mean 'lid'"),
        ({"range": None}, "needs empty"),
        ({"range": [1.5, 0]}, "must be below upper"),
        ({"mimic": "other"}, "got 'other'"),
        ({"after": "hinge"}, "none may wait for itself"),
        ({"axis": "sideways"}, "must be .x, y, z. or one of"),
    ],
)
def test_a_wrong_joint_is_one_error_with_the_valid_choices(change, why):
    spec, (signal,) = read(chest(**change))
    assert spec is None
    assert (signal.severity, signal.code) == ("error", "value")
    with pytest.raises(ValueError, match=why):
        raise ValueError(signal.message)


@pytest.mark.parametrize(
    "change",
    [
        {"vertices": "not base64!"},
        {"vertices": packed([0.0, 1.0], "<f8")},
        {"vertices": packed(CUBE * np.nan, "<f8")},
        {"vertices": packed(CUBE * 1e9, "<f8")},
        {"faces": packed([[0, 1, 99]], "<i4"), "slots": packed([0], "<i4")},
        {"faces": packed([[0, 1, -1]], "<i4"), "slots": packed([0], "<i4")},
        {"slots": packed([0], "<i4")},
        {"role": "ghost"},
        {"mass": -1.0},
        {"materials": ["unknown stuff"]},
    ],
)
def test_an_invalid_scene_is_an_error_of_the_program(change):
    scene = chest()
    scene["shapes"][0] |= change
    scene["materials"].append({"name": "unknown stuff"})
    spec, (signal,) = read(scene)
    assert spec is None
    assert (signal.severity, signal.code) == ("error", "value")


def two(second):
    return np.vstack([CUBE, second]), np.vstack([FACES, FACES + 8]), np.zeros(24, int)


@pytest.mark.skipif(not coacd_installed(), reason="needs CoACD")
def test_a_cavity_stays_open():
    vertices, faces, slots = two(CUBE * 0.8)
    faces[12:] = faces[12:, ::-1]
    (solid,) = split_solids(vertices, faces, slots)
    made, _ = shape_of(solid, False)
    assert made.volume() == pytest.approx(1 - 0.8**3, rel=0.1)
    assert made.signed_distance(np.zeros((1, 3)))[0] > 0.3


def test_without_blender_the_error_names_the_install_commands(tmp_path, monkeypatch):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path))
    with pytest.raises(ProgramError, match=r"uv venv .* && uv pip install .* bpy=="):
        run("import bpy\n", ProgramOptions(language="blender"))
    assert blender_process.unavailable() is not None


def test_the_sdk_refuses_a_blender_program_by_name():
    (signal,) = run("import bpy\nprint(bpy)\n").signals
    assert signal.code == "import"
    assert "program.language" in signal.message
