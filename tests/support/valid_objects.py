"""Valid objects from programs: they pass the object tests, and faults are injected into them.

Each family is a program with parameters, and declares the intents of its joints.
"""

from functools import cache
from string import Template
from typing import NamedTuple

from neoworld_mjx.errors import ProgramError
from neoworld_mjx.program import build
from neoworld_mjx.spec import Intent, ObjectSpec, Vec3

FRONT, UP, LEFT = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
_HEAD = """from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, lathe, sweep
o = Object("$name")
"""
_CABINET = """
X, Y, Z, W = $x, $y, $z, 0.018
body = o.part("carcass", material="$m")
shell = body.add(hollow_box((X, Y, Z), W, open="+x"), by="bottom")
door = o.door("door", body, x=shell.anchor("front")[0], y=(-Y/2, Y/2), z=(0, Z), hinge="$hinge")
door.add(cylinder(0.012, 0.03), at=(door.anchor("front")[0], $side*(Y/2-0.05), Z/2), rpy=(0, 1.5708, 0), by="back", material="steel")
"""
_CHEST = """
X, Y, Z, W, N = $x, $y, $z, 0.016, $n
body = o.part("carcass", material="$m")
shell = body.add(hollow_box((X, Y, Z), W, open="+x"), by="bottom")
front = shell.anchor("front")[0]
step = (Z - W) / N
for k in range(N):
    low = W + k * step
    if k:
        body.add(box((X - W, Y - 2*W, W)), at=(-W/2 + W, 0, low - W/2))
    o.drawer(f"drawer_{k}", body, x=front, y=(-Y/2 + W, Y/2 - W), z=(low, low + step - W), depth=X - W - 0.02)
"""
_LIDDED = """
X, Y, Z, W = $x, $y, $z, 0.01
body = o.part("body", material="$m")
body.add(hollow_box((X, Y, Z), W, open="+z"), by="bottom")
lid = o.part("lid", material="$m")
lid.add(box((X, Y, 0.012)), at=(0, 0, Z + 0.0005), by="bottom")
o.revolute("hinge", body, lid, at=lid.anchor("back.bottom"), axis=(0, -1, 0), range=(0, 1.5))
"""
_LEVER = """
R, H = $x, $z
base = o.part("base", material="$m")
base.add(box((2*R, 2*R, H)), by="bottom")
arm = o.part("lever", material="steel")
arm.add(cylinder(R*0.3, 0.02), at=(0, 0, H + 0.0005), by="bottom")
arm.add(box((R*1.5, 0.02, 0.012)), at=(R*0.6, 0, H + 0.021), by="bottom")
arm.add(cylinder(R*0.3, 0.003), at=(0, 0, H + 0.0195), by="bottom")
o.revolute("turn", base, arm, at=(0, 0, H), axis=(0, 0, 1), range=(0, 1.2))
"""
_CART = """
L, B, R = $x, $y, $z
body = o.part("body", material="$m")
body.add(box((L, B, 0.06)), at=(0, 0, R*1.1), by="bottom")
k = 0
for sx in (-1, 1):
    axle = body.add(cylinder(R*0.2, B + 0.01), at=(sx*L*0.32, 0, R), rpy=(1.5708, 0, 0))
    for sy in (-1, 1):
        wheel = o.part(f"wheel_{k}", material="rubber")
        wheel.add(cylinder(R, 0.02), at=(sx*L*0.32, sy*(B/2 + 0.0155), R), rpy=(1.5708, 0, 0))
        o.continuous(f"axle_{k}", body, wheel, at=(sx*L*0.32, sy*(B/2 + 0.0155), R), axis=(0, 1, 0))
        k += 1
"""
_CUP = """
H, R = $z, $x
body = o.part("body", material="$m")
body.add(lathe([(0, 0), (R*0.6, 0), (R*0.85, H*0.4), (R, H)], thickness=0.004))
body.add(sweep([(R*0.93, 0, H*0.75), (R*1.5, 0, H*0.7), (R*1.5, 0, H*0.4), (R*0.84, 0, H*0.35)], radius=0.004))
"""
_OVEN = """
X, Y, Z, W = $x, $y, $z, 0.02
body = o.part("body", material="$m")
shell = body.add(hollow_box((X, Y, Z), W, open="+x"), by="bottom")
flap = o.door("flap", body, x=shell.anchor("front")[0], y=(-Y/2, Y/2), z=(0, Z*0.8), hinge="bottom", opens=1.4)
body.add(box((0.02, Y, Z*0.2 - 0.004)), at=(shell.anchor("front")[0] - 0.0005, 0, Z), by="back.top")
knob = o.part("knob", material="plastic")
knob.add(cylinder(0.018, 0.02), at=(body.anchor("front")[0] + 0.0005, 0, Z*0.9), rpy=(0, 1.5708, 0), by="back")
o.continuous("turn", body, knob, at=(0, 0, Z*0.9), axis=(1, 0, 0))
"""
_BUTTON = """
X, Y, Z = $x, $y, $z
body = o.part("body", material="$m")
body.add(box((X, Y, Z)), by="bottom")
button = o.part("button", material="plastic")
button.add(cylinder(0.03, 0.012), at=(0, 0, Z + 0.012), by="bottom")
button.add(cylinder(0.01, 0.0115), at=(0, 0, Z + 0.0005), by="bottom")
o.prismatic("press", body, button, axis=(0, 0, 1), range=(0, 0.012))
"""


class Family(NamedTuple):
    """A program with parameters."""

    text: str
    opens: dict[str, Vec3]
    """Opening direction of joints, by the beginning of their names."""
    values: dict[str, object]


FAMILIES = {
    "cabinet": Family(
        _CABINET,
        {"door_hinge": FRONT},
        {"x": 0.35, "y": 0.50, "z": 0.70, "m": "oak", "hinge": "right", "side": 1},
    ),
    "chest": Family(
        _CHEST, {"drawer": FRONT}, {"x": 0.45, "y": 0.60, "z": 0.50, "n": 2, "m": "oak"}
    ),
    "box": Family(_LIDDED, {"hinge": UP}, {"x": 0.30, "y": 0.40, "z": 0.20, "m": "pine"}),
    "lever": Family(_LEVER, {"turn": LEFT}, {"x": 0.08, "z": 0.06, "m": "oak"}),
    "cart": Family(_CART, {}, {"x": 0.40, "y": 0.24, "z": 0.06, "m": "plastic"}),
    "cup": Family(_CUP, {}, {"x": 0.050, "z": 0.07, "m": "porcelain"}),
    "oven": Family(_OVEN, {"flap_hinge": FRONT}, {"x": 0.35, "y": 0.45, "z": 0.35, "m": "pine"}),
    "button": Family(_BUTTON, {"press": UP}, {"x": 0.20, "y": 0.15, "z": 0.08, "m": "oak"}),
}


@cache
def valid_object(name: str) -> ObjectSpec:
    """Build the object of a family.

    Raises:
        ProgramError: its program has errors.
    """
    family = FAMILIES[name]
    text = Template(_HEAD + family.text).substitute(name=name, **family.values)
    built = build(text)
    if built.spec is None or not built.ok:
        errors = "; ".join(s.phrase() for s in built.signals if s.severity == "error")
        raise ProgramError(f"valid object {name}: {errors}")
    return with_intents(built.spec, family.opens)


def with_intents(spec: ObjectSpec, opens: dict[str, Vec3]) -> ObjectSpec:
    """Declare the intents of joints: their type, nine tenths of their range, how they open."""
    joints = []
    for joint in spec.joints:
        direction = next((d for start, d in opens.items() if joint.name.startswith(start)), None)
        ranged = joint.type in ("revolute", "prismatic")
        intent = Intent(
            type=joint.type,
            opens=direction,
            travel=0.9 * (joint.upper - joint.lower) if ranged else None,
        )
        joints.append(joint.model_copy(update={"intent": intent}))
    return spec.model_copy(update={"joints": tuple(joints)})
