# Label: phone stand
import math

from neoworld_mjx.program.sdk import Object, box

depth = 0.1  # 0.08 to 0.13 m
width = 0.08  # 0.06 to 0.1 m
height = 0.1  # 0.07 to 0.13 m
lean = 20.0  # 12 to 30 deg
wood = "oak"  # one of oak, walnut, aluminium

LIP = 0.016
obj = Object("phone_stand", label="phone stand")
stand = obj.part("stand", material=wood)
stand.add(box((depth, width, 0.012)), by="bottom")
a = math.radians(lean)
# A back that leans away from the front, and a lip that keeps the phone's foot.
tall = (height - 0.011) / math.cos(a)
stand.add(
    box((0.008, width, tall)),
    at=(-0.012 - tall * math.sin(a) / 2, 0, 0.006),
    rpy=(0, -a, 0),
    by="bottom",
)
stand.add(box((0.008, width, 0.014)), at=(LIP, 0, 0.011), by="bottom")
