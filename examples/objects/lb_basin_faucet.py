# Written by hand through the mailbox, from a picture of the object alone.
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion

# Basin mixer, given box 0.163 x 0.066 x 0.162 m: a square column with a spout to the front (+x);
# the head on it, with a lever, turns for warm and cold and tips up to open.
U = 0.115  # height of the column; the rest is measured by it
HALF, SPOUT = 0.215 * U, 0.13 * U
BASE = 0.08 * U

tap = Object("faucet", label="white square basin mixer")
# Hollow cast brass with a white coat.
tap.material("white_coat", like="brass", density=4000, rgb=(0.92, 0.92, 0.90))
body = tap.part("body", material="white_coat")
side_on = (math.pi / 2, 0, 0)  # outlines (x, z), drawn out along y
body.add(box((0.57 * U, 0.57 * U, BASE)), at=(0, 0, 0), by="bottom", name="plate")
column = body.add(box((2 * HALF, 2 * HALF, U)), at=(0, 0, BASE), by="bottom", name="column")
spout = [
    (0.1 * U, 0.56 * U),
    (0.90 * U, 0.54 * U),
    (1.13 * U, 0.70 * U),
    (1.13 * U, 0.78 * U),
    (0.1 * U, 0.81 * U),
]
body.add(extrusion(spout, 2 * SPOUT), at=(0, 0, BASE), rpy=side_on, name="spout")
mouth = (1.015 * U + 0.0015, 0, BASE + 0.62 * U - 0.002)
body.add(cylinder(0.09 * U, 0.05 * U), at=mouth, rpy=(0, math.pi - 0.635, 0), name="aerator")

collar = tap.part("collar", material="white_coat")
ring = collar.add(
    cylinder(0.17 * U, 0.045 * U), at=(0, 0, BASE + U + 0.0005), by="bottom", name="ring"
)
tap.revolute(
    "temperature", body, collar, at=ring.anchor("centre"), axis=(0, 0, 1), range=(-0.8, 0.8)
)

head = tap.part("head", material="white_coat")
z = ring.anchor("top")[2] + 0.0005
# The bottom rises to the back from the middle on: there the head sinks when it tips.
block = [(-HALF, 0.067 * U), (-0.01 * U, 0), (HALF, 0), (HALF, 0.275 * U), (-HALF, 0.275 * U)]
head.add(extrusion(block, 2 * HALF), at=(0, 0, z), rpy=side_on, name="block")
head.add(
    box((0.58 * U, 0.10 * U, 0.10 * U)), at=(HALF - 0.002, 0, z + 0.14 * U), by="back", name="lever"
)
tap.revolute("open", collar, head, at=(-0.01 * U, 0, z), axis=(0, -1, 0), range=(0, 0.3))
