# Label: carton
from neoworld_mjx.program.sdk import Object, box

depth = 0.07  # 0.03 to 0.6 m
width = 0.16  # 0.03 to 0.6 m
height = 0.24  # 0.03 to 0.6 m
colour = "orange"  # one of orange, green, blue, white, brown

TONE = {
    "orange": (0.92, 0.6, 0.2),
    "green": (0.35, 0.58, 0.32),
    "blue": (0.25, 0.4, 0.68),
    "white": (0.92, 0.92, 0.9),
    "brown": (0.66, 0.5, 0.33),
}
carton = Object("carton", label="carton")
card = carton.material("card", like="cork", friction=0.5, rgb=TONE[colour], pattern="plain")
body = carton.part("body", material=card)
body.add(box((depth, width, height)), by="bottom")
panel = box((0.0006, 0.7 * width, 0.35 * height))
at = (depth / 2 - 0.0002, 0, 0.6 * height)
body.add(panel, at=at, role="visual", rgb=(0.95, 0.94, 0.88))
