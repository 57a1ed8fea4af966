# Label: light switch
# PartNet-Mobility: Switch
import math

from neoworld_mjx.program.sdk import (
    Object,
    box,
    cylinder,
    extrusion,
    rounded_box,
)

depth = 0.062  # 0.055 to 0.075 m
width = 0.13  # 0.085 to 0.2 m
height = 0.09  # 0.08 to 0.12 m
gangs = 2  # 1 to 4
kind = "rocker"  # one of rocker, toggle, dimmer, button
colour = "white"  # one of white, black, brass

across, flat = (math.pi / 2, 0, 0), (0, math.pi / 2, 0)
switch = Object("light_switch", label="light switch")
shade = {"white": (0.94, 0.94, 0.92), "black": (0.13, 0.13, 0.14), "brass": (0.74, 0.6, 0.3)}[
    colour
]
switch.material("plate", like="pvc", rgb=shade)
key_tone = (0.82, 0.82, 0.8) if colour == "white" else (0.25, 0.25, 0.26)
# A box on the wall holds the plate.
body = switch.part("body", material="plate", mass=0.25)
PLATE, TIP = 0.006, 0.16
half = 0.36 * height
OUT = {
    "rocker": 0.008 * math.cos(TIP) + half * math.sin(TIP),
    "toggle": 0.03,
    "dimmer": 0.022,
    "button": 0.0098,
}[kind]
deep = depth - OUT - PLATE
back = -depth / 2
body.add(
    box((deep + 0.001, width - 0.012, height - 0.004)),
    at=(back, 0, 0),
    by="back.bottom",
    rgb=(0.75, 0.75, 0.74),
)
plate = body.add(
    rounded_box((PLATE, width, height), 0.002), at=(back + deep, 0, 0), by="back.bottom"
)
x, z = plate.anchor("front")[0], height / 2
step = (width - 0.02) / gangs
for k in range(2):
    screw = (x - 0.0005, 0, z + (k - 0.5) * (height - 0.014))
    body.add(
        cylinder(0.003, 0.001), at=screw, rpy=flat, by="back", rgb=(0.6, 0.6, 0.6), role="visual"
    )
for k in range(gangs):
    y = (k - (gangs - 1) / 2) * step
    part = switch.part(f"{kind}_{k + 1}", material="pvc")
    name, wide = f"switch_{k + 1}", min(0.8 * step, 0.05)
    if kind == "rocker":
        # Two faces at an angle: one lies on the plate, the other stands out.
        c, s = math.cos(TIP), math.sin(TIP)
        side = [(0.001, 0), (0.001, half), (0.008, half), (0.009, 0)]
        side += [
            (0.008 * c + half * s, 0.008 * s - half * c),
            (0.001 * c + half * s, 0.001 * s - half * c),
        ]
        part.add(extrusion(side, wide), at=(x, y, z), rpy=across, rgb=key_tone)
        switch.revolute(
            name,
            body,
            part,
            at=(x + 0.001, y, z),
            axis=(0, 1, 0),
            range=(0, TIP),
            friction=0.02,
        )
    elif kind == "toggle":
        body.add(box((0.003, 0.016, 0.034)), at=(x - 0.001, y, z), by="back", rgb=key_tone)
        tilt = 0.35
        arm = (OUT - 0.0068 - 0.003 * math.sin(tilt)) / math.cos(tilt)
        part.add(cylinder(0.004, 0.012), at=(x + 0.0068, y, z), rpy=across, rgb=key_tone)
        handle = box((arm, 0.009, 0.006))
        part.add(
            handle,
            at=(x + 0.0068 + arm * math.cos(tilt) / 2, y, z - arm * math.sin(tilt) / 2),
            rpy=(0, tilt, 0),
            rgb=key_tone,
        )
        switch.revolute(
            name,
            body,
            part,
            at=(x + 0.0068, y, z),
            axis=(0, -1, 0),
            range=(0, 2 * tilt),
            friction=0.02,
        )
    elif kind == "dimmer":
        radius = min(0.4 * step, 0.021)
        knob = part.add(
            cylinder(radius, OUT - 0.001), at=(x + 0.0008, y, z), rpy=flat, by="back", rgb=key_tone
        )
        mark = box((0.001, 0.002, 0.7 * radius))
        part.add(mark, at=knob.anchor("front"), by="bottom", rgb=(0.7, 0.1, 0.1), role="visual")
        switch.revolute(
            name,
            body,
            part,
            at=knob.anchor("centre"),
            axis=(-1, 0, 0),
            range=(0, 4.7),
            friction=0.01,
        )
    else:
        part.add(
            cylinder(min(0.35 * step, 0.016), 0.008),
            at=(x + 0.0018, y, z),
            rpy=flat,
            by="back",
            rgb=key_tone,
        )
        switch.prismatic(name, body, part, axis="back", range=(0, 0.0018))
