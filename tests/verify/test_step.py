"""Step 3 of a run: its object tests use the parse and the program of the object."""

import json
import math

import pytest

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.checks.signals import Allowance
from neoworld_mjx.config import Config, VerifyOptions
from neoworld_mjx.mllm import Panel, Usage
from neoworld_mjx.mllm.requests import Reply
from neoworld_mjx.pipeline.object_steps import verify_objects
from neoworld_mjx.pipeline.step_context import StepContext, object_files, write_files
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Box3D,
    Camera,
    Cylinder,
    GeomSpec,
    JointSpec,
    Material,
    ObjectSpec,
    PartSpec,
    SceneTree,
    Sphere,
    TreeNode,
    bounds,
)
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import answers
from tests.support import furniture as objects

CAMERA = Camera(width=640, height_px=480, fovy=0.8, height=1.0, pitch=0.6)
PIXELS = Box2D(x0=10, y0=10, x1=100, y1=100)
STEEL = Material(name="steel", density=2000, friction=0.5)
GRANT = Allowance("pot", "lid", 0.002, "the lid's rim sits in a groove")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path / "cache"))


def pot(deep=0.0018):
    """A pot with a lid that slides off, 1.8 mm in it at rest."""
    body = GeomSpec(
        name="body", shape=Box(size=(0.2, 0.2, 0.1)), pos=(0, 0, 0.05), material="steel"
    )
    lid = GeomSpec(name="disc", shape=Box(size=(0.2, 0.2, 0.01)), pos=(0, 0, 0.105 - deep),
               material="steel")  # fmt: skip
    slide = {
        "name": "slide", "type": "prismatic", "parent": "pot", "child": "lid", "axis": (1, 0, 0),
        "upper": 0.05, "damping": 5.0, "friction": 1.0,
    }  # fmt: skip
    return ObjectSpec(
        name="pot",
        materials=(STEEL,),
        parts=(PartSpec(name="pot", geoms=(body,)), PartSpec(name="lid", geoms=(lid,))),
        joints=(JointSpec.model_validate(slide),),
    )


def rod():
    """A rod that stands on its end, [0.02, 0.02, 0.5] m."""
    shape = Cylinder(radius=0.01, height=0.5)
    geom = GeomSpec(name="rod", shape=shape, pos=(0, 0, 0.25), material="steel")
    return ObjectSpec(name="rod", materials=(STEEL,), parts=(PartSpec(name="body", geoms=(geom,)),))


def node(name, spec, **more):
    low, high = bounds(spec)
    box = Box3D(position=(1.0, 0, 0), size=tuple((high - low).tolist()), yaw=0.0)
    return TreeNode(name=name, label=name, box2d=PIXELS, box3d=box, **more)


def tilted(degrees):
    return tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(degrees)).tolist())


def pin(name="pin"):
    """A rod with a pointed foot, [0.02, 0.02, 0.1] m."""
    tip = GeomSpec(name="tip", shape=Sphere(radius=0.001), pos=(0, 0, 0.001), material="steel")
    shape = Box(size=(0.02, 0.02, 0.09))
    geom = GeomSpec(name="pin", shape=shape, pos=(0.002, 0, 0.055), material="steel")
    parts = (PartSpec(name="pin", geoms=(geom, tip)),)
    return ObjectSpec(name=name, materials=(STEEL,), parts=parts)


FLAT = """from neoworld_mjx.program.sdk import Object, box
pin = Object("pin")
body = pin.part("pin", material=pin.material("steel", like="steel"))
body.add(box((0.02, 0.02, 0.1)), at=(0, 0, 0), by="bottom", name="body")
"""


class Programmer:
    """Critic that asks for a new program, and programmer that gives one."""

    name, online, secrets = "programmer", False, ()

    def __init__(self):
        self.requests = []

    async def reply(self, request, role, rejected):
        self.requests.append(request)
        found = {"where": "pin", "what": "it has a point", "suggestion": "a foot of 5 cm"}
        verdict = {"findings": [found], "verdict": "reprogram"}
        answer = {"program": FLAT} if request.role == "programmer" else verdict
        return Reply(json.dumps(answer), Usage(), self.name)

    async def close(self): ...


def test_a_new_program_replaces_the_first_which_stays_in_the_history(tmp_path):
    model, config = Programmer(), Config()
    first = FLAT.replace("0.02, 0.02", "0.002, 0.002")
    with RunFolder(tmp_path / "run", config) as run:
        nodes = (
            node("table", objects.chest(), environment=True),
            node("pin", pin(), parent="table"),
        )
        (run.path / "tree.json").write_text(SceneTree(camera=CAMERA, nodes=nodes).to_json())
        for entry, spec in zip(nodes, (objects.chest(), pin()), strict=True):
            with run.step(f"program/{entry.name}", {}) as out:
                files = {"spec.json": spec.to_json(), "program.json": '{"allowances": []}'}
                write_files(out, object_files(entry.name, {**files, "program.py": first}))
        photo = answers.photo()
        with Panel(model) as models:
            context = StepContext(run, config, photo, models)
            verify_objects(context)
            assert [r.name for r in model.requests] == ["simulation:pin", "reprogram:pin"]
            assert run.data["fallbacks"] == []
            assert [note["what"] for note in run.data["notes"]] == ["pin has a new program"]
            verify_objects(context)
            assert len(model.requests) == 2  # The step is finished.
    assert "pin: it has a point -> a foot of 5 cm" in model.requests[1].prompt
    assert [picture.label for picture in model.requests[1].pictures] == ["crop"]
    home = tmp_path / "run" / "objects" / "pin"
    assert (home / "program.py").read_text() == FLAT
    assert (home / "history" / "program" / "program.py").read_text() == first
    assert (home / "history" / "program" / "spec.json").read_text() == pin().to_json()
    assert json.loads((home / "program.json").read_text())["rounds"][0]["stage"] == "reprogram"
    assert json.loads((home / "verify.json").read_text())["passed"]
    changed = ObjectSpec.model_validate_json((home / "spec.json").read_text())
    low, high = bounds(changed)
    assert (high - low).tolist() == pytest.approx([0.02, 0.02, 0.1])


def stepped(tmp_path, spec, allowances=(), **more):
    """Do step verify for one object on a support; return its verify.json and fallbacks."""
    table, cup = objects.chest(), objects.cupboard()
    things = {
        "table": (node("table", table, environment=True), table),
        "cup": (node("cup", cup, parent="table"), cup),
        "thing": (node("thing", spec, **{"parent": "table", **more}), spec),
    }
    config = Config(verify=VerifyOptions(rounds=0))
    with RunFolder(tmp_path / "run", config) as run:
        tree = SceneTree(camera=CAMERA, nodes=tuple(built for built, _ in things.values()))
        (run.path / "tree.json").write_text(tree.to_json())
        for name, (_, built) in things.items():
            home = run.path / "objects" / name
            home.mkdir(parents=True)
            (home / "spec.json").write_text(built.to_json())
            granted = [one._asdict() for one in allowances] if name == "thing" else []
            (home / "program.json").write_text(json.dumps({"allowances": granted}))
        verify_objects(StepContext(run, config, None, None))
        reported = [one for one in run.data["fallbacks"] if one["step"] == "verify/thing"]
        verdict = json.loads((run.path / "objects" / "thing" / "verify.json").read_text())
    return verdict, reported


def test_a_declared_overlap_passes_and_is_reported(tmp_path):
    verdict, reported = stepped(tmp_path / "plain", pot())
    assert any(check["fault"] == "parts_overlap" for check in verdict["checks"])
    assert reported
    verdict, reported = stepped(tmp_path / "granted", pot(), [GRANT])
    assert verdict["passed"], [c for c in verdict["checks"] if c["outcome"] == "FAIL"]
    assert reported == []
    (check,) = [c for c in verdict["checks"] if c["name"] == "part_depth:pot:lid"]
    assert (check["outcome"], check["threshold"], check["doubtful"]) == ("PASS", 0.002, False)
    assert check["value"] == pytest.approx(0.0018, abs=1e-5)
    assert GRANT.reason in check["evidence"]


def test_a_lying_object_is_dropped_in_its_parsed_orientation(tmp_path):
    verdict, reported = stepped(tmp_path, rod(), base_tilt=tilted(83))
    tilts = {c["name"]: c["value"] for c in verdict["checks"] if c["scenario"] == "free_fall"}
    assert verdict["passed"], reported
    assert tilts["tilt"] < 1.0
    # Upright it would fall over.
    assert not run_object_tests(rod()).verdict.passed
