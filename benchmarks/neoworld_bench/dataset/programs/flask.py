# Label: conical flask
from neoworld_mjx.program.sdk import Object, lathe

depth = 0.1  # 0.05 to 0.2 m
width = 0.1  # 0.05 to 0.2 m
height = 0.15  # 0.08 to 0.3 m
fill = "blue"  # one of blue, green, orange, pink

TONE = {
    "blue": (0.2, 0.4, 0.75),
    "green": (0.35, 0.65, 0.4),
    "orange": (0.9, 0.55, 0.2),
    "pink": (0.85, 0.4, 0.55),
}
flask = Object("flask", label="conical flask")
clear = flask.material("clear", like="glass", rgb=(0.85, 0.92, 0.94), alpha=0.4)
body = flask.part("body", material=clear)
r, h = depth / 2, height
outer = [(0, 0), (0.9 * r, 0), (r, 0.06 * h), (0.32 * r, 0.68 * h), (0.32 * r, 0.96 * h)]
body.add(lathe([*outer, (0.4 * r, h)], thickness=0.003))
inner = [(0, 0), (0.86 * r, 0), (0.93 * r, 0.06 * h), (0.66 * r, 0.34 * h)]
body.add(lathe(inner), at=(0, 0, 0.0035), role="visual", rgb=TONE[fill])
