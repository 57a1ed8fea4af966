# Label: kettle
# PartNet-Mobility: Kettle
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sphere, sweep

depth = 0.25  # 0.22 to 0.3 m
width = 0.17  # 0.15 to 0.2 m
height = 0.25  # 0.2 to 0.29 m
kind = "electric"  # one of electric, stove
form = "cone"  # one of cone, belly, straight
finish = "steel"  # one of steel, red, black, cream

kettle = Object("kettle", label="kettle")
tones = {
    "steel": (0.75, 0.76, 0.78),
    "red": (0.65, 0.1, 0.1),
    "black": (0.13, 0.13, 0.14),
    "cream": (0.9, 0.86, 0.76),
}
kettle.material("shell", like="stainless_steel", rgb=tones[finish])
kettle.material("dark", like="abs", rgb=(0.13, 0.13, 0.14))
r = width / 2
electric = kind == "electric"
SPOUT = 0.03 if electric else depth - width  # before the body; the rest is behind it
x = depth / 2 - SPOUT - r
STAND = 0.026 if electric else 0.0
if electric:
    base = kettle.part("base", material="dark", mass=0.35)
    base.add(cylinder(0.92 * r, STAND - 0.005), at=(x, 0, 0), by="bottom")
    base.add(cylinder(0.02, 0.006), at=(x, 0, STAND - 0.006), by="bottom")
    body = kettle.part("body", material="shell")
    kettle.continuous("turn", base, body, at=(x, 0, STAND), axis="up")
else:
    body = kettle.part("body", material="shell")
rim = (height if electric else 0.66 * height) - 0.04
tall = rim - STAND
low = STAND + (0.0008 if STAND else 0)
neck = 0.62 * r
shape = {
    "cone": [(0.92 * r, 0), (r, 0.06 * tall), (0.8 * r, 0.7 * tall), (neck, tall)],
    "belly": [(0.7 * r, 0), (r, 0.35 * tall), (0.94 * r, 0.65 * tall), (neck, tall)],
    "straight": [(0.96 * r, 0), (r, 0.05 * tall), (r, 0.8 * tall), (neck, tall)],
}[form]
body.add(lathe([(0, 0), *shape], thickness=0.0015, sectors=20), at=(x, 0, low), name="shell")


def side(z):
    """Return the radius of the shell at height z."""
    for k in range(len(shape) - 1):
        (a, za), (b, zb) = shape[k], shape[k + 1]
        if za <= z - low <= zb:
            return a + (b - a) * (z - low - za) / (zb - za)
    return neck


# The spout starts in the shell's wall and ends at the box's front.
start, end = low + 0.45 * tall, low + 0.88 * tall
spout = [
    (x + side(start) - 0.004, 0, start),
    (x + r + 0.2 * SPOUT, 0, start + 0.12 * tall),
    (depth / 2 - 0.006, 0, end),
]
body.add(sweep(spout, width=[0.034, 0.026, 0.02], thickness=[0.03, 0.02, 0.01]), name="spout")

lid = kettle.part("lid", material="shell")
top = low + tall + 0.0008
lid.add(
    lathe([(0, 0), (0.6 * neck, 0), (neck, 0.012 - 0.004)], thickness=0.0015),
    at=(x, 0, top + 0.008),
    rpy=(math.pi, 0, 0),
)
lid.add(cylinder(0.006, 0.014), at=(x, 0, top + 0.006), by="bottom", material="dark")
knob_top = rim + 0.038 if electric else top + 0.032
lid.add(sphere(0.011), at=(x, 0, knob_top - 0.011), material="dark")
body.add(
    box((0.02, 0.03, 0.008)),
    at=(x - neck + 0.003, 0, low + tall - 0.001),
    by="front.top",
    material="dark",
)
lid.add(
    box((0.014, 0.026, 0.005)), at=(x - neck + 0.006, 0, top), by="front.bottom", material="dark"
)
kettle.revolute(
    "lid_hinge",
    body,
    lid,
    at=(x - neck - 0.006, 0, top),
    axis=(0, -1, 0),
    range=(0, 1.3),
    opens="up",
    friction=0.02,
    damping=0.01,
)

rear = -depth / 2
if electric:
    a, b = low + 0.85 * tall, low + 0.15 * tall
    loop = [
        (x - side(a) + 0.003, 0, a),
        (rear + 0.03, 0, a + 0.01),
        (rear + 0.009, 0, a - 0.02),
        (rear + 0.009, 0, b + 0.05),
        (rear + 0.02, 0, b + 0.02),
        (x - side(b) + 0.003, 0, b),
    ]
    body.add(sweep(loop, width=0.024, thickness=0.018), material="dark", name="handle")
    switch = kettle.part("switch", material="abs")
    at = (rear + 0.0008, 0, b + 0.025)
    pin = (rear + 0.016, 0, b - 0.0)
    body.add(
        box((0.02, 0.014, 0.014)),
        at=(x - side(low + 0.05 * tall) + 0.004, 0, low + 0.05 * tall),
        by="front",
        material="dark",
    )
    hinge = (x - side(low + 0.05 * tall) - 0.0168, 0, low + 0.05 * tall)
    switch.add(box((0.02, 0.016, 0.006)), at=hinge, by="front", rgb=(0.8, 0.25, 0.1))
    kettle.revolute(
        "switch_on", body, switch, at=hinge, axis=(0, -1, 0), range=(0, 0.35), friction=0.01
    )
    release = kettle.part("lid_button", material="abs")
    spot = (rear + 0.03, 0, a + 0.0208)
    release.add(box((0.014, 0.014, 0.005)), at=spot, by="bottom", rgb=(0.6, 0.62, 0.65))
    kettle.prismatic("lid_release", body, release, axis="down", range=(0, 0.0014), friction=0.2)
else:
    # A bail over the lid falls to the back; a flap closes the spout, and whistles.
    bail = kettle.part("bail", material="dark")
    z = low + 0.8 * tall
    y = side(z) + 0.002
    for s in (-1, 1):
        body.add(box((0.02, 0.02, 0.016)), at=(x, s * (y - 0.011), z), material="dark")
    y += 0.004
    arch = [
        (x, -y, z),
        (x, -y, z + 0.02),
        (x, -0.75 * y, height - 0.012),
        (x, -0.4 * y, height - 0.007),
    ]
    arch += [(px, -py, pz) for px, py, pz in reversed(arch)]
    bail.add(sweep(arch, width=0.018, thickness=0.008))
    kettle.revolute(
        "bail_fall", body, bail, at=(x, 0, z), axis=(0, -1, 0), range=(0, 0.6), friction=0.3
    )
    whistle = kettle.part("whistle", material="dark")
    tip = (depth / 2 - 0.011, 0, end - 0.004)
    body.add(cylinder(0.011, 0.01), at=tip, by="bottom")
    flap = (depth / 2 - 0.01, 0, end + 0.0066)
    whistle.add(box((0.02, 0.02, 0.005)), at=flap, by="bottom", rgb=(0.8, 0.6, 0.2))
    kettle.revolute("whistle_flip", body, whistle, at="back.hinge", range=(0, 1.2), friction=0.005)
