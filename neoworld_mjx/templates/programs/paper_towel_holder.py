# Label: paper towel holder

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sphere, tube

depth = 0.19  # 0.165 to 0.22 m
width = 0.19  # 0.165 to 0.22 m
height = 0.34  # 0.3 to 0.38 m
base_shape = "round"  # one of round, square
finial = "ball"  # one of ball, cone, disc
arm = "yes"  # one of yes, no
metal = "steel"  # one of steel, black, brass

LOOK = {"steel": (0.74, 0.75, 0.77), "black": (0.12, 0.12, 0.13), "brass": (0.78, 0.62, 0.28)}
obj = Object("paper_towel_holder", label="paper towel holder")
coat = obj.material("coat", like="steel", density=4000, rgb=LOOK[metal])
body = obj.part("stand", material=coat)
B, sheet = 0.014, 0.23
if base_shape == "round":
    plate = [(0, 0), (depth / 2, 0), (depth / 2, 0.008), (0.46 * depth, B)]
    body.add(lathe(plate, oval=width / depth), material="walnut")
else:
    body.add(box((depth, width, B)), by="bottom", material="walnut")
top = height - 0.03
body.add(cylinder(0.008, top - B + 0.001), at=(0, 0, top), by="top")
cap = obj.part("finial", material=coat)
if finial == "ball":
    cap.add(sphere(0.0148), at=(0, 0, height), by="top")
elif finial == "cone":
    cap.add(lathe([(0, 0), (0.012, 0), (0.015, 0.01), (0.003, 0.0295)]), at=(0, 0, top + 0.0005))
else:
    cap.add(cylinder(0.016, 0.01), at=(0, 0, height), by="top")
    cap.add(cylinder(0.007, 0.0205), at=(0, 0, top + 0.0005), by="bottom")
obj.continuous("unscrew", body, cap, at=(0, 0, top), axis="top")
roll = obj.part("roll", material="paper", mass=0.25)
R = 0.36 * min(depth, width)
roll.add(tube(R, R - 0.021, sheet, sectors=16), at=(0, 0, B + 0.0005), by="bottom")
roll.add(tube(0.0215, 0.0015, sheet), at=(0, 0, B + 0.0005), by="bottom", material="cardboard")
loose = box((0.0015, 0.03, sheet))
roll.add(loose, at=(R - 0.001, 0, B + 0.0005), by="bottom")
obj.continuous("spin", body, roll, at=(0, 0, B), axis="top")
if arm == "yes":
    # A sprung arm leans on the roll and keeps it from running away.
    lever = obj.part("arm", material=coat)
    y = -(R + 0.008)
    at = (0.0, y, B + 0.0005)
    lever.add(cylinder(0.006, 0.01), at=at, by="bottom")
    lever.add(cylinder(0.004, 0.8 * sheet), at=at, by="bottom")
    lever.add(sphere(0.006), at=(0, y, B + 0.8 * sheet))
    obj.revolute("arm_swing", body, lever, at=at, axis=(1, 0, 0), range=(0, 0.25), friction=0.15)
