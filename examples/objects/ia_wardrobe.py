# Written by hand through the mailbox, from a picture of the object alone.
from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, sweep

# Wardrobe, given box 0.56 x 1.08 x 2.00 m: two tall doors that meet in the middle, on four short
# legs.
X, Y, Z = 0.56, 1.08, 2.00
PULL, FRONT, WALL, LEG = 0.035, 0.020, 0.020, 0.12
DEPTH = X - PULL - FRONT

wardrobe = Object("wardrobe", label="black wardrobe with two doors")
wardrobe.material("dark", like="chipboard", rgb=(0.10, 0.10, 0.10))
wardrobe.material("black", like="plastic", rgb=(0.02, 0.02, 0.02))
carcass = wardrobe.part("carcass", material="dark")
shell = carcass.add(
    hollow_box((DEPTH, Y, Z - LEG), WALL, open="+x"), at=(0, 0, LEG), by="bottom", name="shell"
)
x = shell.anchor("front")[0]
for k, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
    foot = (sx * (DEPTH / 2 - 0.045), sy * (Y / 2 - 0.05), 0)
    carcass.add(
        box((0.08, 0.08, LEG + 0.005)), at=foot, by="bottom", material="black", name=f"leg_{k}"
    )
carcass.add(box((DEPTH - 0.05, Y - 2 * WALL, WALL)), at=(0, 0, 1.72), name="shelf")
rod = cylinder(0.0125, Y - 2 * WALL + 0.004)
carcass.add(rod, at=(0, 0, 1.64), rpy=(1.5708, 0, 0), material="steel", name="clothes_rail")

for name, hinge, side in (("right_door", "right", -1), ("left_door", "left", 1)):
    low, high = sorted((0.0, side * Y / 2))
    door = wardrobe.door(
        name, carcass, x=x, y=(low, high), z=(LEG, Z), hinge=hinge, thickness=FRONT
    )
    px, y, z, H, R = door.anchor("front")[0], side * 0.04, 0.95, 0.075, PULL - 0.007
    bar = [(px - 0.002, y, z - H), (px + R, y, z - H), (px + R, y, z + H), (px - 0.002, y, z + H)]
    door.add(sweep(bar, width=0.014, thickness=0.012), material="black", name=name + "_handle")
