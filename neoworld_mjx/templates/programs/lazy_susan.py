# Label: lazy Susan with a turning tray
from neoworld_mjx.program.sdk import Object, cylinder, lathe, ring, sphere, tube

depth = 0.36  # 0.3 to 0.45 m
width = 0.36  # 0.3 to 0.45 m
height = 0.2  # 0.16 to 0.26 m
tiers = 2  # 1 to 2
feet = 4  # 3 to 5
rim = "rail"  # one of rail, plain
wood = "walnut"  # one of walnut, oak, bamboo, pine

susan = Object("lazy_susan", label="lazy Susan with a turning tray")
BOARD, FOOT, BASE = 0.014, 0.008, 0.014
r, oval = depth / 2, width / depth
round_r = 0.96 * min(depth, width) / 2
LIP = 0.022 if rim == "rail" else 0.0

# The foot stands still; each tray turns by itself, about the one post.
base = susan.part("base", material=wood)
base.add(
    lathe([(0, 0), (r, 0), (r, BASE)], sectors=24, oval=oval),
    at=(0, 0, FOOT),
)
for x, y, _ in ring(feet, 0.5 * r * min(1.0, oval)):
    base.add(cylinder(0.011, FOOT + 0.001), at=(x, y, 0), by="bottom", material="rubber")
top = FOOT + BASE
post = 0.016
peak = height - 0.024
base.add(cylinder(post, peak - top + 0.001), at=(0, 0, peak), by="top", name="post")


def tray(name, z, radius):
    """Add a tray whose board begins at height z and which turns about the post."""
    part = susan.part(name, material=wood)
    hole = post + 0.0008
    part.add(tube(radius, radius - hole, BOARD, sectors=20), at=(0, 0, z), by="bottom")
    part.add(tube(hole + 0.012, 0.012, 0.01), at=(0, 0, z + BOARD - 0.001), by="bottom")
    if LIP:
        rail = tube(radius, 0.004, 0.008, sectors=24)
        part.add(rail, at=(0, 0, z + BOARD + LIP - 0.008), by="bottom", material="brass")
        for x, y, _ in ring(8, radius - 0.003):
            part.add(
                cylinder(0.002, LIP + 0.002),
                at=(x, y, z + BOARD - 0.002),
                by="bottom",
                material="brass",
            )
    susan.continuous(f"{name}_turn", base, part, at=(0, 0, z), axis="top", friction=0.02)


tray("tray", top + 0.0006, round_r)
if tiers == 2:
    # A collar on the post carries the upper tray.
    z = top + 0.55 * (peak - top)
    base.add(cylinder(post + 0.01, 0.006), at=(0, 0, z), by="bottom", name="collar")
    tray("upper_tray", z + 0.0066, 0.62 * round_r)
knob = susan.part("knob", material=wood)
knob.add(cylinder(0.009, 0.008), at=(0, 0, peak + 0.0006), by="bottom", material="brass")
knob.add(sphere(0.009), at=(0, 0, height), by="top")
susan.continuous("knob_turn", base, knob, at=(0, 0, peak), axis="top")
