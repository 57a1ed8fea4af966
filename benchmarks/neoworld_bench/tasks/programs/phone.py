# Label: phone
from neoworld_mjx.program.sdk import Object, box

depth = 0.009  # 0.006 to 0.014 m
width = 0.072  # 0.06 to 0.09 m
height = 0.15  # 0.12 to 0.18 m
case = "black"  # one of black, silver, teal

LOOK = {"black": (0.1, 0.1, 0.11), "silver": (0.75, 0.76, 0.78), "teal": (0.15, 0.45, 0.5)}
obj = Object("phone", label="phone")
obj.material("case", like="electronics", rgb=LOOK[case])
obj.material("screen", like="glass", rgb=(0.05, 0.06, 0.1), alpha=1.0)
phone = obj.part("phone", material="case")
phone.add(box((depth - 0.001, width, height)), by="bottom")
pane = (0.001, width - 0.006, height - 0.01)
phone.add(box(pane), at=(depth / 2 - 0.001, 0, 0.005), by="back.bottom", material="screen")
