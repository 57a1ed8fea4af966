# Label: wooden block
from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion

depth = 0.05  # 0.02 to 0.4 m
width = 0.05  # 0.02 to 0.4 m
height = 0.05  # 0.01 to 0.2 m
form = "box"  # one of box, cylinder, wedge, arch
colour = "red"  # one of red, blue, green, yellow, wood

LOOK = {
    "red": (0.78, 0.2, 0.18),
    "blue": (0.2, 0.35, 0.72),
    "green": (0.25, 0.6, 0.3),
    "yellow": (0.92, 0.76, 0.2),
    "wood": (0.8, 0.64, 0.42),
}
obj = Object("toy_block", label="wooden block")
obj.material("paint", like="pine", rgb=LOOK[colour])
block = obj.part("block", material="paint")
if form == "cylinder":
    block.add(cylinder(min(depth, width) / 2, height), by="bottom")
elif form == "wedge":
    roof = [(-depth / 2, 0), (depth / 2, 0), (0, height)]
    block.add(extrusion(roof, width), rpy=(1.5707963, 0, 0), by="bottom")
elif form == "arch":
    for y in (-1, 1):
        leg = (depth, 0.25 * width, 0.6 * height)
        block.add(box(leg), at=(0, y * 0.375 * width, 0), by="bottom")
    block.add(box((depth, width, 0.4 * height)), at=(0, 0, 0.6 * height), by="bottom")
else:
    block.add(box((depth, width, height)), by="bottom")
