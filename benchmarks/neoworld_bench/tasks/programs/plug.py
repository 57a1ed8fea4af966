# Label: plug with two pins
from neoworld_mjx.program.sdk import Object, box, rounded_box

depth = 0.04  # 0.03 to 0.06 m
width = 0.05  # 0.04 to 0.07 m
height = 0.06  # 0.045 to 0.08 m
colour = "black"  # one of black, white

LOOK = {"black": (0.12, 0.12, 0.13), "white": (0.93, 0.93, 0.92)}
PIN = 0.02
obj = Object("plug", label="plug with two pins")
obj.material("case", like="abs", rgb=LOOK[colour])
plug = obj.part("plug", material="case")
plug.add(rounded_box((depth, width, height - PIN), 0.003), at=(0, 0, PIN), by="bottom")
for y in (-0.013, 0.013):
    plug.add(box((0.008, 0.005, PIN + 0.002)), at=(0, y, 0), by="bottom", material="brass")
