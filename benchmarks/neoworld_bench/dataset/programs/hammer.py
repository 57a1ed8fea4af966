# Label: hammer
import math

from neoworld_mjx.program.sdk import Object, box, cylinder

depth = 0.3  # 0.15 to 0.4 m
width = 0.11  # 0.06 to 0.14 m
height = 0.028  # 0.02 to 0.04 m
handle = "oak"  # one of oak, red, black

# It lies on its side, the head to the front.
hammer = Object("hammer", label="hammer")
TONE = {"oak": (0.65, 0.47, 0.3), "red": (0.7, 0.15, 0.12), "black": (0.15, 0.15, 0.16)}
grip = hammer.material("grip", like="oak", rgb=TONE[handle])
body = hammer.part("body", material=grip)
z = height / 2
body.add(box((depth - 0.01, 0.8 * height, 0.7 * height)), at=(-depth / 2, 0, z), by="back")
steel = "steel"
body.add(box((height, 0.5 * width, height)), at=(depth / 2, 0, z), by="front", material=steel)
body.add(
    cylinder(z, 0.3 * width),
    at=(depth / 2 - z, width / 2, z),
    rpy=(math.pi / 2, 0, 0),
    by="left",
    material=steel,
)
body.add(
    box((height, 0.3 * width, 0.5 * height)),
    at=(depth / 2, -width / 2, z),
    by="front.right",
    material=steel,
)
