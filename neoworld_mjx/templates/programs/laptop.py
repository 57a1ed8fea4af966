# Label: laptop
# PartNet-Mobility: Laptop

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, grid, mirror, rounded_box

depth = 0.24  # 0.2 to 0.28 m
width = 0.34  # 0.28 to 0.42 m
height = 0.024  # 0.018 to 0.03 m
ports = 2  # 1 to 3
finish = "silver"  # one of silver, black, blue, rose

FOOT = 0.002
laptop = Object("laptop", label="laptop")
shade = {
    "silver": (0.74, 0.75, 0.77),
    "black": (0.12, 0.12, 0.13),
    "blue": (0.2, 0.3, 0.45),
    "rose": (0.82, 0.66, 0.62),
}
laptop.material("case", like="electronics", rgb=shade[finish])
dark = (0.06, 0.06, 0.07)
base = laptop.part("base", material="case")
lid_thick = 0.3 * height
top = height - lid_thick - 0.0015
deck = box((depth, width, top - FOOT)).moved((0, 0, FOOT), by="bottom")
# The keys lie in a well, and the touchpad in another before it.
well = box((0.42 * depth, 0.88 * width, 0.008)).moved((-0.1 * depth, 0, top + 0.006), by="top")
pad_size = (0.28 * depth, 0.34 * width)
pocket = box((pad_size[0] + 0.002, pad_size[1] + 0.002, 0.008)).moved(
    (0.31 * depth, 0, top + 0.0035), by="top"
)
base.add(difference(deck, well, pocket), name="deck")
for foot in mirror(mirror((0.4 * depth, 0.42 * width, 0)), "x"):
    base.add(cylinder(0.006, FOOT + 0.0005), at=foot, by="bottom", material="rubber")
for buffer in mirror((depth / 2 - 0.004, 0.45 * width, top - 0.0005)):
    base.add(box((0.004, 0.012, 0.0017)), at=buffer, by="bottom", material="rubber")
pitch = (0.42 * depth / 5, 0.88 * width / 13)
for at in grid((5, 13), pitch, (-0.1 * depth, 0, top - 0.0025)):
    key = box((pitch[0] - 0.002, pitch[1] - 0.002, 0.002))
    base.add(key, at=at, by="bottom", rgb=dark, role="visual")
for k in range(ports):
    for side in mirror((-0.25 * depth + 0.12 * depth * k, width / 2, 0.5 * top)):
        base.add(box((0.014, 0.001, 0.005)), at=side, rgb=dark, role="visual")
pad = laptop.part("touchpad", material="case")
pad.add(
    box((*pad_size, 0.0015)),
    at=(0.31 * depth, 0, top - 0.0025),
    by="bottom",
    rgb=(0.55, 0.56, 0.58),
)
power = laptop.part("power_key", material="case")
at = (-0.34 * depth, 0.4 * width, top + 0.0002)
power.add(box((0.012, 0.014, 0.0008)), at=at, by="bottom", rgb=(0.35, 0.36, 0.38))

lid = laptop.part("lid", material="case")
low = top + 0.0014
shell = lid.add(
    rounded_box((depth, width, height - low), min(0.002, 0.4 * lid_thick)),
    at=(0, 0, height),
    by="top",
)
lid.add(
    box((0.8 * depth, 0.93 * width, 0.0004)),
    at=(0.04 * depth, 0, low),
    by="bottom",
    rgb=(0.08, 0.1, 0.16),
    role="visual",
)
badge = cylinder(0.06 * depth, 0.0004)
lid.add(badge, at=(0, 0, height - 0.0003), by="bottom", rgb=(0.95, 0.95, 0.96), role="visual")
line = (-depth / 2, 0, low - 0.0007)
opened = laptop.revolute(
    "hinge", base, lid, at=line, axis=(0, -1, 0), range=(0, 2.3), friction=1.2, opens="up"
)
laptop.prismatic("touchpad_press", base, pad, axis="down", range=(0, 0.0018), friction=0.5)
laptop.prismatic("power_press", base, power, axis="down", range=(0, 0.0008), friction=0.3)
shutter = laptop.part("camera_shutter", material="abs")
spot = (depth / 2 - 0.006, 0.01, low - 0.0002)
shutter.add(box((0.006, 0.012, 0.0008)), at=spot, by="top", rgb=(0.7, 0.1, 0.1))
laptop.prismatic("shutter_slide", lid, shutter, axis="right", range=(0, 0.02))
