from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box

# Cabinet, given box 0.64 x 0.78 x 0.35 m: a sliding door in front of the half at -y (the picture's
# left); a fixed panel, flush with the carcass, closes the other half.
X, Y, Z = 0.64, 0.78, 0.35
WALL, FRONT, PULL, GAP = 0.018, 0.050, 0.085, 0.001
DEPTH = X - FRONT - PULL - GAP
WIDTH = 0.405  # of the door
R = 0.02

cabinet = Object("fs_slidecabinet", label="wall cabinet with a sliding door")
wood = cabinet.material(
    "warm_wood",
    like="oak",
    rgb=(0.68, 0.43, 0.21),
    rgb2=(0.40, 0.23, 0.10),
    pattern="grain",
    along="y",
)
metal = cabinet.material(
    "grey_metal", like="aluminium", rgb=(0.62, 0.62, 0.62), metallic=0.2, roughness=0.6
)

carcass = cabinet.part("carcass", material=wood)
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom", name="shell")
x = shell.anchor("front")[0]
edge = -Y / 2 + WIDTH  # the door's inner edge
panel_low = edge - 0.02
carcass.add(
    box((WALL, Y / 2 - WALL - panel_low, Z - 2 * WALL)),
    at=(x, panel_low, Z / 2),
    by="front.right",
    name="fixed_panel",
)

door = cabinet.part("door", material=wood)
door.add(
    box((FRONT, WIDTH, Z - 0.002)), at=(x + GAP, -Y / 2, 0.001), by="back.right.bottom", name="leaf"
)
cabinet.prismatic("door_slide", carcass, door, axis="left", range=(0, Y - WIDTH), opens="left")

px = x + GAP + FRONT
bar_x, bar_y = px + PULL - R, -Y / 2 + 0.041
door.add(cylinder(R, 0.285), at=(bar_x, bar_y, 0.16), material=metal, name="bar")
for i, z in enumerate((0.055, 0.262)):
    door.add(
        cylinder(0.015, PULL - R + 0.003),
        at=(px - 0.003, bar_y, z),
        rpy=(0, 1.5708, 0),
        by="back",
        material=metal,
        name=f"post_{i}",
    )
