# Label: drinking bottle
# PartNet-Mobility: Bottle

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sweep, tube

depth = 0.075  # 0.064 to 0.09 m
width = 0.075  # 0.064 to 0.09 m
height = 0.24  # 0.18 to 0.3 m
closure = "flip"  # one of flip, loop, sport, pump
form = "straight"  # one of straight, waisted, shoulder
colour = "blue"  # one of blue, green, steel, pink, clear

bottle = Object("bottle", label="drinking bottle")
tones = {
    "blue": (0.15, 0.35, 0.65),
    "green": (0.3, 0.55, 0.35),
    "steel": (0.7, 0.71, 0.73),
    "pink": (0.9, 0.55, 0.62),
    "clear": (0.78, 0.88, 0.92),
}
alpha = 0.6 if colour == "clear" else 1.0
metal = "stainless_steel" if colour == "steel" else "pet"
bottle.material("wall", like=metal, rgb=tones[colour], alpha=alpha)
bottle.material("dark", like="polypropylene", rgb=(0.14, 0.14, 0.15))
body = bottle.part("body", material="wall")
r, oval = depth / 2, width / depth
TOP = {"flip": 0.014, "loop": 0.03, "sport": 0.024, "pump": 0.03}[closure]
COLLAR, NECK = 0.022, 0.02
shoulder = height - TOP - COLLAR - 0.001
neck = 0.28 * min(depth, width)
shape = {
    "straight": [(r, 0.01), (r, 0.8 * shoulder)],
    "waisted": [
        (r, 0.01),
        (r, 0.25 * shoulder),
        (0.84 * r, 0.45 * shoulder),
        (r, 0.68 * shoulder),
        (r, 0.8 * shoulder),
    ],
    "shoulder": [
        (0.85 * r, 0.01),
        (r, 0.5 * shoulder),
        (r, 0.6 * shoulder),
        (0.75 * r, 0.85 * shoulder),
    ],
}[form]
profile = [(0, 0), (shape[0][0] - 0.006, 0), *shape, (neck, shoulder)]
body.add(lathe(profile, thickness=0.0018, sectors=16, oval=oval), name="wall")
body.add(
    tube(0.9 * neck, 0.002, NECK, sectors=16), at=(0, 0, shoulder - 0.002), by="bottom", name="neck"
)

# The collar is screwed on the neck; what opens is on it.
collar = bottle.part("collar", material="dark")
low = shoulder + 0.001
wide, top = 0.9 * neck + 0.0045, low + COLLAR
collar.add(tube(wide, 0.0025, COLLAR - 0.002, sectors=16), at=(0, 0, low), by="bottom")
deck = 0.005 if closure != "pump" else 0.004
collar.add(tube(wide, wide - deck, 0.002, sectors=16), at=(0, 0, top), by="top")
bottle.continuous("unscrew", body, collar, at=(0, 0, low + 0.01), axis="up")
if closure == "flip":
    lid = bottle.part("lid", material="wall")
    disc = lid.add(cylinder(wide, TOP - 0.0006), at=(0, 0, height), by="top")
    lid.add(
        box((0.006, 0.012, 0.006)),
        at=(wide - 0.001, 0, disc.anchor("bottom")[2] + 0.001),
        by="back.bottom",
    )
    bottle.revolute(
        "lid_hinge",
        collar,
        lid,
        at=(-wide, 0, top + 0.0003),
        axis=(0, -1, 0),
        range=(0, 2.2),
        friction=0.004,
        opens="up",
    )
elif closure == "loop":
    collar.add(cylinder(0.6 * wide, TOP - 0.012), at=(0, 0, top - 0.001), by="bottom")
    loop = bottle.part("loop", material="dark")
    pin, y = top + TOP - 0.02, 0.6 * wide + 0.003
    arch = [
        (0, -y, pin),
        (0, -y, pin + 0.008),
        (0, -0.7 * y, height - 0.002),
        (0, 0.7 * y, height - 0.002),
        (0, y, pin + 0.008),
        (0, y, pin),
    ]
    loop.add(sweep(arch, width=0.008, thickness=0.004))
    bottle.revolute(
        "loop_fold", collar, loop, at=(0, 0, pin), axis=(0, 1, 0), range=(-1.2, 1.2), friction=0.01
    )
elif closure == "sport":
    collar.add(tube(0.011, 0.003, 0.012), at=(0, 0, top - 0.001), by="bottom")
    collar.add(tube(wide, wide - 0.009, 0.002), at=(0, 0, top), by="top")
    spout = bottle.part("spout", material="wall")
    spout.add(tube(0.0065, 0.002, TOP - 0.008), at=(0, 0, height - 0.008), by="top")
    spout.add(tube(0.0105, 0.005, 0.008), at=(0, 0, height), by="top")
    bottle.prismatic("spout_pull", collar, spout, axis="up", range=(0, 0.006), friction=0.5)
else:
    collar.add(tube(0.0075, 0.0025, 0.008), at=(0, 0, top - 0.002), by="bottom")
    collar.add(tube(wide, wide - 0.0055, 0.002), at=(0, 0, top), by="top")
    rod = bottle.part("plunger", material="polypropylene")
    rod.add(cylinder(0.0042, TOP - 0.008 + 0.03), at=(0, 0, height - 0.008), by="top")
    bottle.prismatic("pump", collar, rod, axis="down", range=(0, TOP - 0.017), friction=0.6)
    head = bottle.part("nozzle", material="dark")
    head.add(cylinder(0.011, 0.0076), at=(0, 0, height), by="top")
    head.add(
        sweep(
            [(0, 0, height - 0.004), (0.85 * r, 0, height - 0.004), (0.95 * r, 0, height - 0.01)],
            radius=0.0035,
        )
    )
    bottle.continuous("nozzle_turn", rod, head, at=(0, 0, height - 0.004), axis="up")
