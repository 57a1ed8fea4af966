# Label: cantilever tool box
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, sweep

depth = 0.22  # 0.18 to 0.3 m
width = 0.44  # 0.32 to 0.56 m
height = 0.3  # 0.24 to 0.36 m
tiers = 2  # 1 to 2
handles = "round"  # one of round, flat
colour = "red"  # one of red, blue, green, grey

COLOURS = {"red": (0.7, 0.1, 0.08), "blue": (0.1, 0.25, 0.55), "green": (0.15, 0.4, 0.2)}
WALL, LINK, LOOP, LID = 0.003, 0.003, 0.045, 0.002
obj = Object("tool_box", label="cantilever tool box")
paint = obj.material(
    "paint", like="steel", density=3000, rgb=COLOURS.get(colour, (0.45, 0.46, 0.48))
)
long, level = width - 2 * (LINK + 0.0005) - 0.008, (height - LOOP - LID - 0.002) / (tiers + 1.4)
floor = 1.4 * level
body = obj.part("body", material=paint)
body.add(hollow_box((depth, long, floor - 0.001), WALL), by="bottom")

# Every arm leans inwards by 45 degrees at rest, and swings outwards to as much on the other
# side; what it carries stays level, for it turns back as far as the arm turns.
arm_length = 0.6 * depth / 2
rise = arm_length * math.sin(math.pi / 4)
for side, name in ((1, "front"), (-1, "back")):
    below, master = body, None
    for k in range(tiers):
        z = floor + k * level
        foot = (side * (0.36 - 0.08 * k) * depth, z - rise / 2)
        tip = (foot[0] - side * rise, z + rise / 2)
        arm = obj.part(f"{name}_arm_{k + 1}", material="steel")
        for y in (-long / 2 - 0.0005, long / 2 + 0.0005):
            out = math.copysign(LINK / 2, y)
            path = [(foot[0], y + out, foot[1]), (tip[0], y + out, tip[1])]
            arm.add(sweep(path, width=LINK, thickness=0.012))
            for px, pz in (foot, tip):
                rivet = cylinder(0.005, LINK + 0.004)
                at, face = (px, y, pz), "right" if y > 0 else "left"
                arm.add(rivet, at=at, rpy=(math.pi / 2, 0, 0), by=face)
        axis = (0, side, 0)
        pivot = (foot[0], 0, foot[1])
        joint = f"{name}_swing_{k + 1}"
        if master is None:
            turn = obj.revolute(joint, below, arm, at=pivot, axis=axis, range=(0, math.pi / 2))
            master = turn
        else:
            obj.revolute(
                joint, below, arm, at=pivot, axis=axis, range=(0, math.pi / 2), mimic=master
            )
        tray = obj.part(f"{name}_tray_{k + 1}", material=paint)
        shape = hollow_box((depth / 2 - 0.001, long, level - 0.001), WALL)
        tray.add(shape, at=(side * (depth / 4 + 0.0003), 0, z), by="bottom")
        obj.revolute(
            f"{name}_level_{k + 1}", arm, tray, at=(tip[0], 0, tip[1]), axis=axis,
            range=(-math.pi / 2, 0), mimic=master, multiplier=-1,
        )  # fmt: skip
        below = tray
    top = floor + tiers * level
    lid = obj.part(f"{name}_lid", material=paint)
    at = (side * (depth / 2 - 0.001), 0, top - 0.0005)
    lid.add(box((depth / 2 - 0.02, long, LID)), at=at, by=f"{name}.bottom")
    hinge = lid.anchor(f"{name}.bottom")
    obj.revolute(
        f"{name}_lid_hinge", below, lid, at=hinge, axis=(0, side, 0), range=(0, 1.9), friction=0.15
    )
    inner, half = side * 0.008, 0.2 * long
    grip = [(inner, -half, top - 0.01), (inner, -half, height - 0.007)]
    grip += [(inner, half, height - 0.007), (inner, half, top - 0.01)]
    if handles == "round":
        below.add(sweep(grip, radius=0.007), material="abs")
    else:
        below.add(sweep(grip, width=0.012, thickness=0.013), material="abs")
    below.add(box((0.006, 2 * half + 0.03, 0.012)), at=(side * 0.004, 0, top - 0.001), by="top")
