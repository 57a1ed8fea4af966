# Label: nutcracker soldier

from neoworld_mjx.program.sdk import Object, box, capsule, cylinder, difference, frustum, sphere

depth = 0.12  # 0.1 to 0.15 m
width = 0.12  # 0.1 to 0.15 m
height = 0.36  # 0.28 to 0.48 m
hat = "shako"  # one of shako, crown, cone
coat = "red"  # one of red, blue, green

COAT = {"red": (0.7, 0.1, 0.1), "blue": (0.12, 0.2, 0.55), "green": (0.1, 0.4, 0.2)}
obj = Object("nutcracker", label="nutcracker soldier")
cloth = obj.material("coat", like="pine", rgb=COAT[coat])
dark = obj.material("dark", like="pine", rgb=(0.1, 0.1, 0.12))
skin = obj.material("skin", like="pine", rgb=(0.93, 0.75, 0.6))
white = obj.material("white", like="pine", rgb=(0.93, 0.93, 0.9))
gold = obj.material("gilt", like="pine", rgb=(0.85, 0.65, 0.2))
BASE, H = 0.06 * height, height
trunk = 0.26 * width
body = obj.part("body", material=cloth)
body.add(box((depth, 0.85 * width, BASE)), by="bottom", material=gold)
for y in (-0.14 * width, 0.14 * width):
    body.add(cylinder(0.12 * width, 0.24 * H), at=(0, y, BASE), by="bottom", material=white)
    body.add(cylinder(0.13 * width, 0.09 * H), at=(0, y, BASE), by="bottom", material=dark)
    toe = box((0.3 * depth, 0.2 * width, 0.05 * H))
    body.add(toe, at=(0.1 * depth, y, BASE), by="bottom", material=dark)

# Trunk and head are slit from front to back for the jaw, which is one piece with the lever.
low, neck, crown = 0.3 * H, 0.6 * H, 0.76 * H
slot = box((1, 0.2 * width, 0.26 * H)).moved((0, 0, 0.53 * H))
body.add(difference(cylinder(trunk, neck - low).moved((0, 0, (low + neck) / 2)), slot))
chin = cylinder(0.88 * trunk, crown - neck + 0.002).moved((0, 0, (neck + crown) / 2))
body.add(difference(chin, slot), material=skin)
for y in (-0.35 * trunk, 0.35 * trunk):
    eye = sphere(0.02 * H)
    body.add(eye, at=(0.76 * trunk, y, 0.715 * H), material=white, role="visual")
    pupil = (0.76 * trunk + 0.013 * H, y, 0.715 * H)
    body.add(sphere(0.009 * H), at=pupil, material=dark, role="visual")
body.add(sphere(0.016 * H), at=(0.88 * trunk, 0, 0.69 * H), material=skin)
for z in (0.34, 0.37):
    stud = sphere(0.008 * H)
    body.add(stud, at=(trunk, 0, z * H), material=gold, role="visual")
belt = cylinder(trunk + 0.001, 0.018 * H)
body.add(belt, at=(0, 0, 0.315 * H), by="bottom", material=gold)
for y in (-trunk, trunk):
    shoulder = cylinder(0.07 * width, 0.02 * H)
    body.add(shoulder, at=(0, y * 0.7, neck), by="top", material=gold)
if hat == "shako":
    body.add(cylinder(0.95 * trunk, H - crown), at=(0, 0, crown), by="bottom", material=dark)
    body.add(cylinder(trunk, 0.02 * H), at=(0, 0, crown), by="bottom", material=gold)
    body.add(sphere(0.025 * H), at=(0.95 * trunk, 0, 0.87 * H), material=gold)
elif hat == "crown":
    body.add(cylinder(trunk, 0.12 * H), at=(0, 0, crown), by="bottom", material=gold)
    body.add(sphere(0.065 * H), at=(0, 0, H), by="top", material=cloth)
else:
    body.add(frustum(trunk, 0.004, H - crown), at=(0, 0, crown), by="bottom", material=cloth)

lever = obj.part("lever", material=dark)
z = 0.62 * H
wide = 0.2 * width - 0.002
jaw = box((0.9 * trunk, wide, 0.055 * H))
lever.add(jaw, at=(0.95 * trunk, 0, z), by="front.top", material=skin)
lever.add(
    box((0.02 * H, wide, 0.1 * H)),
    at=(0.97 * trunk, 0, z - 0.01 * H),
    by="front.top",
    material=white,
)
reach = depth / 2 - 0.008
lever.add(box((reach + 0.1 * trunk, wide, 0.04 * H)), at=(-reach, 0, z), by="back.top")
lever.add(box((0.016, wide, 0.4 * H)), at=(-depth / 2, 0, z), by="back.top")
pin = (0, 0, z - 0.02 * H)
obj.revolute("crack", body, lever, at=pin, axis=(0, 1, 0), range=(0, 0.3), friction=0.04)
for side, name in ((1, "left"), (-1, "right")):
    arm = obj.part(f"{name}_arm", material=cloth)
    thick = 0.5 * width - trunk - 0.0005
    at = (0, side * (trunk + 0.0005 + thick / 2), 0.56 * H)
    arm.add(capsule(thick / 2, 0.17 * H), at=(0, at[1], at[2] - 0.085 * H))
    hand = sphere(0.48 * thick)
    arm.add(hand, at=(0, at[1], at[2] - 0.19 * H), material=skin)
    cuff = cylinder(0.5 * thick, 0.02 * H)
    arm.add(cuff, at=(0, at[1], at[2] - 0.15 * H), material=gold)
    obj.revolute(f"{name}_shoulder", body, arm, at=at, axis=(0, -1, 0), range=(-0.6, 3.0))
