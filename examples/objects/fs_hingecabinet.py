from neoworld_mjx.program.sdk import Object, cylinder, hollow_box

# Wall cabinet, given box 0.64 x 0.69 x 0.35 m: two thick doors, hinged at the outer edges.
X, Y, Z = 0.64, 0.69, 0.35
WALL, FRONT, PULL, GAP = 0.018, 0.045, 0.09, 0.001
INSET = 0.008  # the doors are a little narrower than the carcass
DEPTH = X - FRONT - PULL - GAP

cabinet = Object("fs_hingecabinet", label="wall cabinet with two doors")
wood = cabinet.material(
    "warm_wood",
    like="oak",
    rgb=(0.70, 0.43, 0.20),
    rgb2=(0.45, 0.26, 0.11),
    pattern="grain",
    along="y",
)
metal = cabinet.material(
    "grey_metal", like="aluminium", rgb=(0.62, 0.62, 0.62), metallic=0.2, roughness=0.6
)

carcass = cabinet.part("carcass", material=wood)
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom", name="shell")
x = shell.anchor("front")[0]


def add_handle(door, y):
    px = door.anchor("front")[0]
    bar_x = px + PULL - 0.02
    door.add(cylinder(0.02, 0.286), at=(bar_x, y, 0.165), material=metal, name="bar")
    for i, z in enumerate((0.06, 0.27)):
        door.add(
            cylinder(0.015, PULL - 0.02 + 0.003),
            at=(px - 0.003, y, z),
            rpy=(0, 1.5708, 0),
            by="back",
            material=metal,
            name=f"post_{i}",
        )


left = cabinet.door(
    "left_door",
    carcass,
    x=x,
    y=(0, Y / 2 - INSET),
    z=(0, Z),
    hinge="left",
    thickness=FRONT,
    gap=GAP,
    material=wood,
)
right = cabinet.door(
    "right_door",
    carcass,
    x=x,
    y=(-Y / 2 + INSET, 0),
    z=(0, Z),
    hinge="right",
    thickness=FRONT,
    gap=GAP,
    material=wood,
)
add_handle(left, 0.065)
add_handle(right, -0.065)
