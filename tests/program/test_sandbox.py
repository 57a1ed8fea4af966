import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from neoworld_mjx.export import object_files
from neoworld_mjx.program.building import run

HEAD = "from neoworld_mjx.program.sdk import *\n".replace(
    "*", "Object, box, capsule, cylinder, ellipsoid, hollow_box, lathe, prism, sphere"
)
CUP = (
    HEAD
    + """
import math

cup = Object("cup", label="espresso cup")
body = cup.part("body", material="ceramic")
body.add(lathe([(0, 0), (0.02, 0), (0.03, 0.02), (0.035, 0.06)], thickness=0.003), name="bowl")
for i in range(5):
    a = math.radians(-60 + 30 * i)
    at = (0, 0.035 + 0.018 * math.cos(a), 0.035 + 0.018 * math.sin(a))
    body.add(capsule(0.004, 0.01), at=at, rpy=(a, 0, 0))
cup.site("grasp", body, body.anchor("left"))
print(box((1, 2, 3)).size)
"""
)
CABINET = (
    HEAD
    + """
cab = Object("cabinet")
wood = cab.material("wood_dark", like="oak", rgb=(0.4, 0.3, 0.2))
frame = cab.part("frame", material=wood)
frame.add(hollow_box((0.4, 0.8, 0.7), 0.018, open="+x"), at=(0, 0, 0.35))
door = cab.part("door", material=wood)
door.add(box((0.018, 0.8, 0.7)), at=frame.anchor("front"), by="back")
hinge = cab.revolute(
    "hinge", frame, door, at=door.anchor("left.back"), axis=(0, 0, 2), range=(0, 1.6)
)
knob = cab.part("knob", material="brass", mass=0.05)
knob.add(sphere(0.02), at=door.anchor("front"), by="back")
cab.continuous("turn", door, knob, at=knob.anchor("centre"), axis=(1, 0, 0), mimic=hinge)
"""
)


def test_the_object_stands_on_its_origin():
    spec = run(CUP).spec
    assert spec is not None
    from neoworld_mjx.spec import bounds

    low, high = bounds(spec)
    assert abs(low[2]) < 1e-12 and abs(low[0] + high[0]) < 1e-12 and abs(low[1] + high[1]) < 1e-12


def test_type_check_names_every_misuse_with_its_line():
    text = HEAD + "o = Object('x')\np = o.part('body', colour='red')\np.ad(box((1, 2)))\nbox('a')\n"
    built = run(text)
    assert built.spec is None
    assert {(s.code, s.line) for s in built.signals} == {("type", 3), ("type", 4), ("type", 5)}


def test_a_wrong_value_is_reported_with_its_line():
    text = HEAD + "o = Object('x')\ndef leg(w):\n    return box((w, 1, 1))\n\nleg(-1)\n"
    (signal,) = run(text).signals
    assert (signal.code, signal.line) == ("value", 4)
    assert "box size must be a positive length" in signal.message


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("", "no_object"),
        ("Object('a')\nObject('b')", "many_objects"),
        ("Object('a')", "no_parts"),
        ("Object('a').part('p')", "empty_part"),
        (
            "o = Object('a')\nfor n in 'pq':\n    o.part(n, material='oak').add(box((1, 1, 1)))",
            "orphan_part",
        ),
    ],
)
def test_structure(body: str, code: str):
    built = run(HEAD + body)
    assert built.spec is None
    assert code in {signal.code for signal in built.signals}


def test_programs_share_nothing():
    run(HEAD + "o = Object('a')\np = o.part('p', material='oak')\nm = o.material('mine', 'oak')")
    spec = run(CUP).spec
    assert spec is not None and {m.name for m in spec.materials} == {"ceramic"}
    unknown = run(HEAD + "Object('b').part('p', material='mine')")
    assert "'mine'" in unknown.signals[0].message


def test_default_losses_follow_from_the_child():
    spec = run(CABINET).spec
    assert spec is not None
    hinge = next(joint for joint in spec.joints if joint.name == "hinge")
    assert hinge.damping > 0 and hinge.friction > 0
    given = run(CABINET.replace("range=(0, 1.6)", "range=(0, 1.6), damping=0, friction=0.25")).spec
    assert given is not None
    hinge = next(joint for joint in given.joints if joint.name == "hinge")
    assert (hinge.damping, hinge.friction) == (0, 0.25)


def test_programs_run_at_once_without_mixing():
    texts = [CUP, CABINET, COMBINED]
    alone = [run(text) for text in texts]
    with ThreadPoolExecutor(8) as threads:
        together = list(threads.map(run, texts * 3))
    for one, built in zip(alone * 3, together, strict=True):
        assert built.spec == one.spec and built.lines == one.lines


COMBINED = """
from neoworld_mjx.program.sdk import Object, box, cylinder, difference, mirror, sphere, union
o = Object("thing")
p = o.part("body", material="oak")
holes = [cylinder(0.013, 0.3).moved(at, rpy=(0.3, 0.2, 0)) for at in mirror((0.05, 0.03, 0), "x")]
base = difference(box((0.2, 0.1, 0.06)), *holes)
p.add(union(base, sphere(0.04).moved((0, 0, 0.03))), by="bottom")
q = o.part("knob", material="steel")
q.add(sphere(0.01), at=p.anchor("top"), by="bottom")
o.ball("neck", p, q, at="centre", swing=0.4)
"""


def test_csg_and_balls_have_the_same_bytes_everywhere():
    built = run(COMBINED)
    assert built.spec is not None, built.signals
    tell = (
        "import hashlib, sys\n"
        "from neoworld_mjx.export import object_files\n"
        "from neoworld_mjx.spec import ObjectSpec\n"
        "spec = ObjectSpec.model_validate_json(sys.stdin.read())\n"
        "print(hashlib.sha256(repr(sorted(object_files(spec).items())).encode()).hexdigest())\n"
    )
    other = subprocess.run(
        [sys.executable, "-c", tell],
        input=built.spec.to_json(),
        capture_output=True,
        text=True,
        check=True,
    )
    files = repr(sorted(object_files(built.spec).items()))
    assert other.stdout.strip() == hashlib.sha256(files.encode()).hexdigest()


TWO_TYPES = """from neoworld_mjx.program.sdk import Object, box, extrusion

o = Object("a")
body = o.part("body", material="pine")
for side in ("left", "right"):
    o.material(side, like="pine")
for k in range(2):
    side = [(0, 0), (0.1, 0), (0.1, 0.1)] if k == LAST else side
body.add(extrusion(side, 0.1), by="bottom")
"""


def test_a_name_of_two_types_is_judged_by_its_value_at_run_time():
    built = run(TWO_TYPES.replace("LAST", "1"))
    assert built.spec is not None and not built.errors
    [error] = run(TWO_TYPES.replace("LAST", "7")).signals
    assert (error.code, error.line) == ("value", 9) and "'right'" in error.message
