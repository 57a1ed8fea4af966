from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror

# Wardrobe, box 0.55 x 1.03 x 1.80 m: two hinged doors, four square feet.
X, Y, Z = 0.55, 1.03, 1.80
WALL, FRONT, PULL, GAP = 0.018, 0.018, 0.042, 0.001
DEPTH = X - FRONT - PULL - GAP
FOOT, LEG, INSET = 0.15, 0.08, 0.042

w = Object("ia_wardrobe", label="black wardrobe")
black = w.material("black_board", like="mdf", rgb=(0.20, 0.20, 0.20))
jet = w.material("black_metal", like="steel", rgb=(0.02, 0.02, 0.02), metallic=0.0, roughness=0.7)

carcass = w.part("carcass", material=black)
shell = carcass.add(hollow_box((DEPTH, Y, Z - FOOT), WALL, open="+x"), at=(0, 0, FOOT), by="bottom")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
inside = (-Y / 2 + WALL, Y / 2 - WALL)
w.shelf(carcass, x=(back + WALL, x - 0.02), y=inside, z=Z - 0.32, thickness=WALL)
carcass.add(
    cylinder(0.0125, Y - 2 * WALL),
    at=((x + back) / 2, 0, Z - 0.40),
    rpy=(1.5708, 0, 0),
    material="steel",
    name="rail",
)
ly = Y / 2 - INSET - LEG / 2
for lx in (x + FRONT - INSET - LEG / 2, back + INSET + LEG / 2):
    for at in mirror((lx, ly, 0)):
        carcass.add(box((LEG, LEG, FOOT)), at=at, by="bottom")

HZ, LENGTH, BAR = 0.97, 0.135, 0.013
for name, y, hinge, hy in (
    ("left_door", (0, Y / 2), "left", 0.041),
    ("right_door", (-Y / 2, 0), "right", -0.041),
):
    door = w.door(
        name, carcass, x=x, y=y, z=(FOOT, Z), hinge=hinge, thickness=FRONT, material=black
    )
    px = door.anchor("front")[0]
    door.add(box((BAR, BAR, LENGTH)), at=(px + PULL, hy, HZ), by="front", material=jet, name="bar")
    for end in (-1, 1):
        at = (px - 0.003, hy, HZ + end * (LENGTH / 2 - BAR / 2))
        door.add(box((PULL - 0.006, BAR, BAR)), at=at, by="back", material=jet)
