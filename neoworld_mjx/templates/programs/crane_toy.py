# Label: toy tower crane
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, sweep, torus

depth = 0.5  # 0.4 to 0.7 m
width = 0.2  # 0.16 to 0.26 m
height = 0.6  # 0.48 to 0.8 m
bays = 6  # 4 to 9
cab = "box"  # one of box, none
colour = "yellow"  # one of yellow, red, blue

PAINT = {"yellow": (0.92, 0.72, 0.1), "red": (0.75, 0.13, 0.1), "blue": (0.15, 0.3, 0.65)}
obj = Object("crane_toy", label="toy tower crane")
paint = obj.material("paint", like="abs", rgb=PAINT[colour])
grey = obj.material("grey", like="concrete", rgb=(0.6, 0.6, 0.58))
B, M, BAR = 0.03, 0.032, 0.006
# The mast stands a little behind the middle; the jib reaches forward to the box's front.
x0 = -depth / 2 + 0.32 * depth
base = obj.part("mast", material=paint)
base.add(box((min(0.62 * depth, 0.3), width, B)), at=(x0, 0, 0), by="bottom", material=grey)
top = 0.8 * height


def truss(part, x, y, z, long, axis):
    """Diagonals between two chords along x or z."""
    step = long / bays
    for k in range(bays):
        a, b = (0, 1) if k % 2 else (1, 0)
        if axis == "z":
            path = [(x[a], y, z + k * step), (x[b], y, z + (k + 1) * step)]
        else:
            path = [(x + k * step, y, z[a]), (x + (k + 1) * step, y, z[b])]
        part.add(sweep(path, width=0.004, thickness=0.004))


for y in (-M / 2, M / 2):
    for x in (x0 - M / 2, x0 + M / 2):
        base.add(box((BAR, BAR, top - B + 0.001)), at=(x, y, B - 0.001), by="bottom")
    truss(base, (x0 - M / 2, x0 + M / 2), y, B, top - B - 0.01, "z")
base.add(box((M + BAR, M + BAR, 0.012)), at=(x0, 0, top), by="top")

jib = obj.part("jib", material=paint)
z = top + 0.0005
jib.add(cylinder(0.024, 0.014), at=(x0, 0, z), by="bottom")
rail = z + 0.02
front, back = depth / 2, -depth / 2
for y in (-M / 2, M / 2):
    jib.add(box((depth, BAR, BAR)), at=(0, y, rail))
chord = rail + 0.035
jib.add(box((front - x0 - 0.03, BAR, BAR)), at=(x0, 0, chord), by="back")
for y in (-M / 2, M / 2):
    step = (front - x0 - 0.04) / bays
    for k in range(bays):
        foot = (x0 + k * step, y, rail)
        jib.add(
            sweep(
                [foot, (foot[0] + step / 2, 0, chord), (foot[0] + step, y, rail)],
                width=0.003,
                thickness=0.003,
            )
        )
for x in (back + 0.003, x0, front - 0.003):
    jib.add(box((BAR, M + BAR, BAR)), at=(x, 0, rail))
jib.add(box((0.026, M + BAR, 0.012)), at=(x0, 0, rail), by="top")
jib.add(box((BAR, BAR, height - rail)), at=(x0, 0, height), by="top")
for end in (front - 0.08, back + 0.02):
    jib.add(
        sweep(
            [(x0, 0, height - 0.006), (end, 0, (chord if end > 0 else rail) - 0.001)], radius=0.0015
        )
    )
jib.add(box((0.05, M + 0.01, 0.05)), at=(back, 0, rail + 0.004), by="back.top", material=grey)
if cab == "box":
    jib.add(
        box((0.04, 0.034, 0.04)),
        at=(x0 + 0.02, M / 2 + 0.001, rail),
        by="right",
        rgb=(0.85, 0.87, 0.88),
    )
    pane = box((0.002, 0.026, 0.02))
    jib.add(
        pane,
        at=(x0 + 0.04, M / 2 + 0.018, rail + 0.005),
        by="back",
        role="visual",
        rgb=(0.3, 0.45, 0.55),
    )
obj.continuous("slew", base, jib, at=(x0, 0, z), axis="top")

# The trolley hangs under the rails; the hook slides along the rope.
trolley = obj.part("trolley", material="abs")
start = x0 + 0.09
under = rail - BAR / 2 - 0.0005
trolley.add(box((0.044, M + BAR, 0.014)), at=(start, 0, under), by="top")
rope = under - 0.014
trolley.add(cylinder(0.0005, 0.6 * rope), at=(start, 0, rope), by="top", role="visual")
obj.prismatic(
    "trolley_run", jib, trolley, axis="front", range=(0, front - 0.03 - start), friction=0.3
)
hook = obj.part("hook", material="steel")
hang = rope - 0.0005
hook.add(box((0.016, 0.012, 0.02)), at=(start, 0, hang), by="top", material=paint)
hook.add(cylinder(0.002, 0.012), at=(start, 0, hang - 0.019), by="top")
hook.add(torus(0.008, 0.002, arc=4.4), at=(start, 0, hang - 0.038), rpy=(math.pi / 2, -0.6, 0))
obj.prismatic("hook_lower", trolley, hook, axis="bottom", range=(0, 0.5 * rope), friction=0.6)
