# Label: pepper mill with a crank

from neoworld_mjx.program.sdk import Object, box, cylinder, ellipsoid, hollow_box, lathe, sphere

depth = 0.1  # 0.09 to 0.12 m
width = 0.06  # 0.05 to 0.075 m
height = 0.2  # 0.15 to 0.3 m
shape = "waisted"  # one of waisted, straight, box
metal = "brass"  # one of brass, steel, copper
wood = "walnut"  # one of walnut, oak, pine

# The crank reaches forward over the body, whose middle is the origin.
R, WALL, ARM, KNOB = width / 2, 0.004, 0.004, 0.024
top = height - KNOB - ARM - 0.012
obj = Object("pepper_mill", label="pepper mill")
fitting = obj.material("fitting", like=metal, density=2500)
body = obj.part("body", material=fitting if shape == "straight" else wood)
low = 0.045
if shape == "box":
    body.add(hollow_box((width, width, low), WALL, open="+x"), by="bottom")
    cup = obj.drawer(
        "drawer",
        body,
        x=R,
        y=(-R + WALL, R - WALL),
        z=(WALL, low - WALL),
        depth=width - 0.007,
        wall=0.002,
        front=0.004,
        gap=0.001,
        overlay=0.001,
    )
    at = (R + 0.004, 0, low / 2)
    cup.add(sphere(0.005), at=at, by="back", material=fitting)
    body.add(box((width + 0.0, width, 0.004)), at=(0, 0, low - 0.001), by="bottom")
    dome = [(0, 0), (0.8 * R, 0), (0.85 * R, 0.2 * (top - low)), (0.5 * R, top - low)]
    body.add(lathe(dome, thickness=WALL), at=(0, 0, low + 0.002), name="hopper")
else:
    # The lower third unscrews: the powder collects there.
    cup = obj.part("cup", material=fitting if shape == "straight" else wood)
    base = [(0, 0), (R, 0), (R, 0.004), (R * (1 if shape == "straight" else 0.86), low)]
    cup.add(lathe(base, thickness=WALL), name="cup")
    rise = top - low
    if shape == "waisted":
        waist = [(0.86, 0), (0.62, 0.35), (0.66, 0.6), (0.95, 0.85), (0.9, 0.93), (0.6, 1)]
    else:
        waist = [(1, 0), (1, 0.93), (0.85, 1)]
    profile = [(0, 0), *((R * r, rise * z) for r, z in waist)]
    body.add(lathe(profile, thickness=WALL), at=(0, 0, low + 0.0005), name="barrel")
    obj.revolute("unscrew", body, cup, at=(0, 0, 0), axis=(0, 0, -1), range=(0, 4.0))
body.add(cylinder(0.6 * R, 0.006), at=(0, 0, top - 0.002), by="bottom", material=fitting)
dome = ellipsoid((0.45 * R, 0.45 * R, 0.008))
body.add(dome, at=(0, 0, top + 0.003), material=fitting)

crank = obj.part("crank", material=fitting)
z = height - KNOB - ARM
reach = depth - R - 0.011
crank.add(cylinder(0.008, ARM), at=(0, 0, z + ARM), by="top")
body.add(cylinder(0.004, z - top), at=(0, 0, top), by="bottom", material=fitting)
crank.add(box((reach, 0.012, ARM)), at=(0, 0, z), by="back.bottom")
crank.add(cylinder(0.006, ARM), at=(reach, 0, z), by="bottom")
crank.add(cylinder(0.006, 0.004), at=(0, 0, z + ARM), by="bottom")
obj.continuous("grind", body, crank, at=(0, 0, z), axis=(0, 0, 1))
knob = obj.part("knob", material=wood)
outline = [(0, 0), (0.006, 0), (0.011, 0.6 * KNOB), (0.008, 0.93 * KNOB), (0, KNOB - 0.0005)]
knob.add(lathe(outline), at=(reach, 0, z + ARM + 0.0005))
obj.continuous("knob_turn", crank, knob, at=(reach, 0, z), axis=(0, 0, 1))
