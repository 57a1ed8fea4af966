# Label: mug
from neoworld_mjx.program.sdk import Object, lathe, sweep

depth = 0.115  # 0.09 to 0.14 m
width = 0.082  # 0.06 to 0.1 m
height = 0.095  # 0.06 to 0.12 m
colour = "white"  # one of white, blue, red, green, yellow

TONE = {
    "white": (0.93, 0.92, 0.89),
    "blue": (0.18, 0.33, 0.6),
    "red": (0.7, 0.18, 0.15),
    "green": (0.25, 0.5, 0.35),
    "yellow": (0.9, 0.74, 0.25),
}
mug = Object("mug", label="mug")
glaze = mug.material("glaze", like="ceramic", rgb=TONE[colour])
body = mug.part("body", material=glaze)
r = width / 2
x = -depth / 2 + r
body.add(
    lathe([(0, 0), (0.85 * r, 0), (r, 0.06 * height), (r, height)], thickness=0.004), at=(x, 0, 0)
)
far = depth / 2 - 0.005
path = [
    (x + r - 0.002, 0, 0.8 * height),
    (far - 0.004, 0, 0.78 * height),
    (far, 0, 0.55 * height),
    (far - 0.006, 0, 0.32 * height),
    (x + r - 0.002, 0, 0.24 * height),
]
body.add(sweep(path, radius=0.005), name="handle")
