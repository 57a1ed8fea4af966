from neoworld_mjx.program.sdk import Object, box, hollow_box, mirror

# Wall cabinet, box 0.36 x 0.90 x 0.72 m: a bifold of two fronts that lifts up.
X, Y, Z = 0.36, 0.90, 0.72
WALL, FRONT, PULL, GAP = 0.018, 0.018, 0.034, 0.001
DEPTH = X - FRONT - PULL - GAP
SPLIT = Z / 2

cab = Object("ia_cabinet4", label="wall cabinet with a bifold lift-up front")
grey = cab.material("light_grey", like="mdf", rgb=(0.74, 0.74, 0.74))
metal = cab.material(
    "matt_metal", like="steel", rgb=(0.78, 0.78, 0.78), metallic=0.1, roughness=0.6
)

carcass = cab.part("carcass", material=grey)
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom")
x, back = shell.anchor("front")[0], shell.anchor("back")[0]
cab.shelf(
    carcass, x=(back + WALL, x - 0.02), y=(-Y / 2 + WALL, Y / 2 - WALL), z=SPLIT, thickness=WALL
)

upper = cab.part("upper_door", material=grey)
upper.add(
    box((FRONT, Y, Z - SPLIT - 0.00075)), at=(x + GAP, 0, Z), by="back.top", name="upper_panel"
)
lift = cab.revolute(
    "lift",
    carcass,
    upper,
    at=upper.anchor("top.back"),
    axis=(0, -1, 0),
    range=(0, 1.5),
    friction=12,
)

lower = cab.part("lower_door", material=grey)
lower.add(
    box((FRONT, Y, SPLIT - 0.00075)), at=(x + GAP, 0, 0), by="back.bottom", name="lower_panel"
)
cab.revolute(
    "fold",
    upper,
    lower,
    at=lower.anchor("top.back"),
    axis=(0, 1, 0),
    range=(0, 2.25),
    mimic=lift,
    multiplier=1.5,
)

# Bar handle of square section near the lower edge.
px = lower.anchor("front")[0]
HZ, LENGTH, BAR = 0.07, 0.17, 0.012
lower.add(box((BAR, LENGTH, BAR)), at=(px + PULL, 0, HZ), by="front", material=metal, name="bar")
for post in mirror((px - 0.003, LENGTH / 2 - BAR / 2, HZ)):
    lower.add(box((PULL - 0.006, BAR, BAR)), at=post, by="back", material=metal)
