import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box

# Square basin mixer, box 0.172 x 0.063 x 0.16 m, origin at the middle of the base plate.
X, Y, Z = 0.172, 0.063, 0.16
BACK = -Y / 2
TIP = BACK + X  # front end of the spout
UPRIGHT = (math.pi / 2, 0, 0)  # outlines in (x, z), extruded along y

tap = Object("lb_basin_faucet", label="white basin mixer")
white = tap.material(
    "white_enamel", like="steel", density=4000, rgb=(0.93, 0.93, 0.91), metallic=0, roughness=0.35
)

body = tap.part("body", material=white)
body.add(box((Y, Y, 0.0077)), at=(0, 0, 0), by="bottom", name="plate")
CX, W, TOP = -0.0037, 0.051, 0.1225  # column
body.add(
    hollow_box((W, 0.050, TOP - 0.0075), 0.0025, open="+z"),
    at=(CX, 0, 0.0075),
    by="bottom",
    name="column",
)
body.add(cylinder(0.0165, TOP - 0.011), at=(CX, 0, 0.0095), by="bottom", name="cartridge")
front = CX + W / 2
spout = [
    (front - 0.001, 0.0715),
    (0.112, 0.0750),
    (TIP, 0.0958),
    (TIP, 0.1035),
    (front - 0.001, 0.1005),
]
body.add(extrusion(spout, 0.0245), rpy=UPRIGHT, name="spout")
slope = math.atan2(0.0958 - 0.0750, TIP - 0.112)
mid = ((0.112 + TIP) / 2, 0, (0.0750 + 0.0958) / 2)
nx, nz = math.sin(slope), -math.cos(slope)
body.add(
    cylinder(0.0115, 0.007),
    at=(mid[0] + 0.0015 * nx, 0, mid[2] + 0.0015 * nz),
    rpy=(0, -slope, 0),
    name="aerator",
)

# Collar: turns for warm and cold. Head with lever: tips up on it.
collar = tap.part("collar", material=white)
NECK = TOP - 0.001  # just above the cartridge
collar.add(cylinder(0.0185, 0.1276 - NECK), at=(CX, 0, NECK), by="bottom", name="ring")
tap.revolute("turn", body, collar, at=(CX, 0, NECK), axis=(0, 0, 1), range=(-0.8, 0.8))

handle = tap.part("handle", material=white)
LOW, PIVOT = 0.1281, -0.003
hf, hb = front, -0.0310
head = [(PIVOT, LOW), (hf, LOW), (hf, Z), (hb, Z), (hb, LOW + (PIVOT - hb) * math.tan(0.26))]
handle.add(extrusion(head, 0.049), rpy=UPRIGHT, name="head")
lever = [(hf - 0.001, 0.1388), (0.0958, 0.1407), (0.0958, 0.1512), (hf - 0.001, 0.1502)]
handle.add(extrusion(lever, 0.0097), rpy=UPRIGHT, name="lever")
tap.revolute(
    "tip",
    collar,
    handle,
    at=(PIVOT, 0, LOW),
    axis=(0, -1, 0),
    range=(0, 0.26),
    friction=0.15,
)
