# Label: block
from neoworld_mjx.program.sdk import Object, rounded_box

depth = 0.06  # 0.01 to 1.0 m
width = 0.06  # 0.01 to 1.0 m
height = 0.06  # 0.005 to 0.6 m
colour = "oak"  # one of oak, pine, walnut, red, blue, green, yellow, white, grey, brick, soap

TONE = {
    "red": (0.75, 0.16, 0.13),
    "blue": (0.15, 0.3, 0.65),
    "green": (0.2, 0.5, 0.28),
    "yellow": (0.92, 0.75, 0.2),
    "white": (0.92, 0.92, 0.9),
    "grey": (0.5, 0.52, 0.54),
    "soap": (0.93, 0.86, 0.66),
}
block = Object("block", label="block")
like = colour if colour in ("oak", "pine", "walnut", "brick", "soap") else "wood"
look = {"rgb": TONE[colour], "pattern": "plain"} if colour in TONE else {}
paint = block.material("paint", like=like, **look)
edge = 0.05 * min(depth, width, height)
block.part("body", material=paint).add(rounded_box((depth, width, height), edge), by="bottom")
