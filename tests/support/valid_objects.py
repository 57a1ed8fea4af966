"""Valid objects from programs: they pass the object tests, and faults are injected into them.

Each family is a program with parameters, and declares the intents of its joints.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from string import Template

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import ProgramError
from neoworld_mjx.program import build
from neoworld_mjx.spec import Intent, ObjectSpec, Vec3

FRONT, UP, LEFT = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
_HEAD = """from neoworld_mjx.program.sdk import *
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
_LAPTOP = """
X, Y = $x, $y
base = o.part("base", material="aluminium", mass=$mass)
base.add(box((X, Y, 0.016)), by="bottom")
screen = o.part("screen", material="aluminium", mass=$mass/3)
screen.add(box((X, Y, 0.007)), at=(0, 0, 0.0165), by="bottom")
o.revolute("hinge", base, screen, at=screen.anchor("back.bottom"), axis=(0, -1, 0), range=(0, 1.5), friction=$hold)
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
_TABLE = """
X, Y, Z = $x, $y, $z
body = o.part("body", material="$m")
body.add(box((X, Y, 0.025)), at=(0, 0, Z), by="top")
for sx in (-1, 1):
    for sy in (-1, 1):
        body.add(box((0.04, 0.04, Z - 0.025)), at=(sx*(X/2-0.04), sy*(Y/2-0.04), 0), by="bottom")
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


@dataclass(frozen=True)
class Family:
    """A program with parameters."""

    text: str
    opens: dict[str, Vec3]
    """Opening direction of joints, by the beginning of their names."""
    sizes: tuple[dict[str, object], ...]


FAMILIES: dict[str, Family] = {
    "cabinet": Family(
        _CABINET,
        {"door_hinge": FRONT},
        (
            {"x": 0.30, "y": 0.40, "z": 0.60, "m": "mdf", "hinge": "left", "side": -1},
            {"x": 0.35, "y": 0.50, "z": 0.70, "m": "oak", "hinge": "right", "side": 1},
            {"x": 0.25, "y": 0.30, "z": 0.35, "m": "pine", "hinge": "left", "side": -1},
            {"x": 0.45, "y": 0.60, "z": 0.90, "m": "plywood", "hinge": "right", "side": 1},
        ),
    ),
    "chest": Family(
        _CHEST,
        {"drawer": FRONT},
        (
            {"x": 0.40, "y": 0.50, "z": 0.25, "n": 1, "m": "mdf"},
            {"x": 0.45, "y": 0.60, "z": 0.50, "n": 2, "m": "oak"},
            {"x": 0.50, "y": 0.80, "z": 0.75, "n": 3, "m": "pine"},
            {"x": 0.50, "y": 0.70, "z": 0.95, "n": 4, "m": "plywood"},
        ),
    ),
    "box": Family(
        _LIDDED,
        {"hinge": UP},
        (
            {"x": 0.20, "y": 0.30, "z": 0.12, "m": "walnut"},
            {"x": 0.30, "y": 0.40, "z": 0.20, "m": "pine"},
            {"x": 0.15, "y": 0.20, "z": 0.08, "m": "plastic"},
            {"x": 0.40, "y": 0.60, "z": 0.30, "m": "oak"},
        ),
    ),
    "laptop": Family(
        _LAPTOP,
        {"hinge": UP},
        (
            {"x": 0.22, "y": 0.31, "mass": 1.2, "hold": 0.3},
            {"x": 0.25, "y": 0.36, "mass": 1.8, "hold": 0.5},
            {"x": 0.20, "y": 0.28, "mass": 0.9, "hold": 0.2},
        ),
    ),
    "lever": Family(
        _LEVER,
        {"turn": LEFT},
        (
            {"x": 0.06, "z": 0.05, "m": "abs"},
            {"x": 0.08, "z": 0.06, "m": "oak"},
            {"x": 0.10, "z": 0.08, "m": "aluminium"},
        ),
    ),
    "cart": Family(
        _CART,
        {},
        (
            {"x": 0.30, "y": 0.16, "z": 0.04, "m": "pine"},
            {"x": 0.40, "y": 0.24, "z": 0.06, "m": "plastic"},
            {"x": 0.50, "y": 0.30, "z": 0.07, "m": "plywood"},
        ),
    ),
    "cup": Family(
        _CUP,
        {},
        ({"x": 0.040, "z": 0.09, "m": "ceramic"}, {"x": 0.050, "z": 0.07, "m": "porcelain"}),
    ),
    "table": Family(
        _TABLE,
        {},
        (
            {"x": 0.60, "y": 0.90, "z": 0.45, "m": "oak"},
            {"x": 0.80, "y": 1.40, "z": 0.74, "m": "pine"},
            {"x": 0.40, "y": 0.40, "z": 0.50, "m": "walnut"},
        ),
    ),
    "oven": Family(
        _OVEN,
        {"flap_hinge": FRONT},
        (
            {"x": 0.45, "y": 0.55, "z": 0.50, "m": "mdf"},
            {"x": 0.35, "y": 0.45, "z": 0.35, "m": "pine"},
            {"x": 0.50, "y": 0.60, "z": 0.60, "m": "plywood"},
        ),
    ),
    "button": Family(
        _BUTTON,
        {"press": UP},
        (
            {"x": 0.12, "y": 0.12, "z": 0.05, "m": "abs"},
            {"x": 0.20, "y": 0.15, "z": 0.08, "m": "oak"},
            {"x": 0.16, "y": 0.24, "z": 0.06, "m": "aluminium"},
        ),
    ),
}


def valid_objects(count: int | None = None) -> Iterator[ObjectSpec]:
    """Yield valid objects, one of each family before the second of any.

    Args:
        count: number of objects; None is all.

    Raises:
        ProgramError: a family's program has errors.
    """
    order = [
        (name, k)
        for k in range(max(len(family.sizes) for family in FAMILIES.values()))
        for name, family in FAMILIES.items()
        if k < len(family.sizes)
    ]
    for name, k in order[:count]:
        yield valid_object(name, k)


@cache
def valid_object(name: str, k: int) -> ObjectSpec:
    """Build the k-th object of a family.

    Raises:
        ProgramError: its program has errors.
    """
    family = FAMILIES[name]
    text = Template(_HEAD + family.text).substitute(name=f"{name}_{k}", **family.sizes[k])
    text = text.replace("sdk import *", "sdk import " + ", ".join(_CALLED))
    built = build(text, ProgramOptions(sandbox="cpython"))
    if built.spec is None or not built.ok:
        errors = "; ".join(s.phrase() for s in built.signals if s.severity == "error")
        raise ProgramError(f"valid object {name}_{k}: {errors}")
    return with_intents(built.spec, family.opens)


_CALLED = ("Object", "box", "cylinder", "hollow_box", "lathe", "sweep")


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
