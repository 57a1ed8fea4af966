# Label: kitchen faucet
# PartNet-Mobility: Faucet
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    frustum,
    sphere,
    sweep,
    tube,
)

depth = 0.26  # 0.2 to 0.32 m
width = 0.24  # 0.2 to 0.28 m
height = 0.34  # 0.28 to 0.42 m
control = "lever"  # one of lever, crosses, blades
spray = "yes"  # one of yes, no
finish = "chrome"  # one of chrome, brass, black

flat, across = (0, math.pi / 2, 0), (math.pi / 2, 0, 0)
faucet = Object("kitchen_faucet", label="kitchen faucet")
tones = {"chrome": (0.8, 0.81, 0.83), "brass": (0.78, 0.62, 0.28), "black": (0.12, 0.12, 0.13)}
faucet.material("metal", like="aluminium", rgb=tones[finish])
# The plate of the basin's edge carries the column; it is heavy, as it is bolted down.
base = faucet.part("base", material="metal", mass=2.5)
rear = -depth / 2
reach = 0.6 * depth
base.add(box((reach, width, 0.008)), at=(rear, 0, 0), by="back.bottom")
x = rear + 0.035
column = 0.3 * height
base.add(frustum(0.028, 0.022, column), at=(x, 0, 0.007), by="bottom")

# The spout turns on the column; its end is bent down.
spout = faucet.part("spout", material="metal")
low = column + 0.0078
out = depth / 2 - 0.014
crown = height - 0.012
path = [
    (x, 0, low + 0.008),
    (x, 0, 0.72 * height),
    (x + 0.25 * (out - x), 0, 0.95 * crown),
    (x + 0.5 * (out - x), 0, crown + 0.003),
]
path += [(x + 0.8 * (out - x), 0, 0.93 * crown), (out, 0, 0.78 * crown), (out, 0, 0.62 * crown)]
spout.add(cylinder(0.021, 0.02), at=(x, 0, low), by="bottom")
spout.add(sweep(path, radius=0.011, smooth=3))
faucet.revolute(
    "spout_turn", base, spout, at=(x, 0, low), axis="up", range=(-0.9, 0.9), friction=0.2
)
if spray == "yes":
    head = faucet.part("spray_head", material="metal")
    head.add(
        frustum(0.011, 0.0138, 0.055),
        at=(out, 0, 0.62 * crown - 0.0006),
        rpy=(math.pi, 0, 0),
        by="top",
    )
    head.add(
        cylinder(0.01, 0.001), at=(out, 0, 0.62 * crown - 0.0556), by="top", rgb=(0.15, 0.15, 0.16)
    )
    faucet.prismatic("spray_pull", spout, head, axis="down", range=(0, 0.06), friction=2.0)
else:
    spout.add(tube(0.0125, 0.003, 0.015), at=(out, 0, 0.62 * crown), by="top")
if control == "lever":
    # A collar turns for warm and cold; the lever on it tips up to open.
    collar = faucet.part("collar", material="metal")
    z = 0.62 * column
    stub = base.add(cylinder(0.016, 0.03), at=(x, -0.015, z), rpy=across, by="left")
    turn = collar.add(
        cylinder(0.02, 0.03), at=(x, stub.anchor("right")[1] - 0.0006, z), rpy=across, by="left"
    )
    faucet.revolute(
        "warm_cold",
        base,
        collar,
        at=turn.anchor("centre"),
        axis=(0, 1, 0),
        range=(-0.6, 0.6),
        friction=0.3,
    )
    lever = faucet.part("lever", material="metal")
    y = turn.anchor("right")[1]
    arm = [(x, y - 0.005, z), (x, y - 0.012, z + 0.045), (x, y - 0.02, z + 0.1)]
    lever.add(sweep(arm, width=[0.016, 0.014, 0.012], thickness=0.007))
    lever.add(box((0.016, 0.008, 0.016)), at=(x, y - 0.0006, z), by="left")
    faucet.revolute(
        "open",
        collar,
        lever,
        at=(x, y - 0.004, z - 0.006),
        axis=(1, 0, 0),
        range=(0, 0.6),
        friction=0.2,
    )
else:
    for name, y in (("cold", -0.36 * width), ("warm", 0.36 * width)):
        base.add(frustum(0.024, 0.017, 0.04), at=(x, y, 0.007), by="bottom")
        handle = faucet.part(f"{name}_handle", material="metal")
        z = 0.0478
        handle.add(cylinder(0.015, 0.022), at=(x, y, z), by="bottom")
        if control == "crosses":
            for turn in (0, math.pi / 2):
                handle.add(cylinder(0.005, 0.05), at=(x, y, z + 0.014), rpy=(math.pi / 2, 0, turn))
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                tip = (x + 0.025 * dx, y + 0.025 * dy, z + 0.014)
                handle.add(sphere(0.0065), at=tip)
        else:
            handle.add(box((0.075, 0.014, 0.007)), at=(x - 0.012, y, z + 0.018), by="back")
        tone = (0.15, 0.3, 0.8) if name == "cold" else (0.8, 0.15, 0.1)
        handle.add(cylinder(0.006, 0.001), at=(x, y, z + 0.022), by="bottom", rgb=tone)
        way = "down" if name == "warm" else "up"
        faucet.revolute(
            f"{name}_turn", base, handle, at=(x, y, z), axis=way, range=(0, 1.57), friction=0.1
        )
# The rod behind the column lifts the basin's plug.
rod = faucet.part("plug_rod", material="metal")
base.add(cylinder(0.007, 0.012), at=(rear + 0.1, 0.25 * width, 0.007), by="bottom")
rod.add(cylinder(0.003, 0.04), at=(rear + 0.1, 0.25 * width, 0.0198), by="bottom")
rod.add(sphere(0.007), at=(rear + 0.1, 0.25 * width, 0.062))
faucet.prismatic("plug_lift", base, rod, axis="up", range=(0, 0.03), friction=0.5)
