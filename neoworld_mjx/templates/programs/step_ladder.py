# Label: step ladder
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, sweep

depth = 0.75  # 0.6 to 0.9 m
width = 0.5  # 0.42 to 0.6 m
height = 1.3  # 0.9 to 1.8 m
steps = 4  # 3 to 6
tray = "yes"  # one of yes, no
handrail = "hoop"  # one of hoop, none
stuff = "aluminium"  # one of aluminium, pine, oak

obj = Object("step_ladder", label="step ladder")
rail_stuff = obj.material("rail", like=stuff, density=500 if stuff != "aluminium" else 900)
feet = obj.material("feet", like="rubber", rgb=(0.15, 0.15, 0.15))
hoop = 0.3 if handrail == "hoop" else 0.0
top = height - hoop - 0.03
x_top = -0.12 * depth
frame = obj.part("front_frame", material=rail_stuff)
half = width / 2 - 0.015
foot_x, foot_z = depth / 2 - 0.03, 0.0
lean = math.atan2(foot_x - x_top, top)


def on_rail(z):
    """Return x of the front rails at a height."""
    return x_top + (top - z) * (foot_x - x_top) / top


for y in (-half, half):
    frame.add(sweep([(foot_x, y, 0.025), (x_top, y, top)], width=0.025, thickness=0.055))
    frame.add(box((0.06, 0.03, 0.03)), at=(depth / 2, y, 0), by="front.bottom", material=feet)
for k in range(steps):
    z = (k + 1) * top / (steps + 0.6)
    tread = box((0.1, 2 * half, 0.025))
    frame.add(tread, at=(on_rail(z) - 0.005, 0, z))
plate = box((0.2, 2 * half + 0.025, 0.03))
frame.add(plate, at=(x_top + 0.05, 0, top + 0.015))
if hoop:
    z = top + 0.02
    bow = [
        (x_top, -half, z),
        (x_top - 0.03, -half, height - 0.0125),
        (x_top - 0.03, half, height - 0.0125),
        (x_top, half, z),
    ]
    frame.add(sweep(bow, radius=0.0125))

# The rear frame folds against the front one about a rod below the platform.
rear = obj.part("rear_frame", material=rail_stuff)
pivot = (x_top - 0.06, 0, top - 0.06)
for y in (-half, half):
    lug = box((0.09, 0.025, 0.04))
    frame.add(lug, at=(x_top + 0.012, y, pivot[2]), by="front")
inner = half - 0.035
back_x = -depth / 2 + 0.03
for y in (-inner, inner):
    rear.add(sweep([(back_x, y, 0.025), (pivot[0], y, pivot[2])], width=0.02, thickness=0.035))
    rear.add(box((0.06, 0.03, 0.03)), at=(-depth / 2, y, 0), by="back.bottom", material=feet)
for share in (0.25, 0.6):
    at = (back_x + share * (pivot[0] - back_x), 0, 0.025 + share * (pivot[2] - 0.025))
    rear.add(box((0.02, 2 * inner, 0.03)), at=at)
rear.add(cylinder(0.008, 2 * half - 0.027), at=pivot, rpy=(math.pi / 2, 0, 0), material="steel")
spread = math.atan2(pivot[0] - back_x, pivot[2])
obj.revolute("fold", frame, rear, at=pivot, axis=(0, -1, 0), range=(0, 0.6 * spread), friction=1.5)
if tray == "yes":
    shelf = obj.part("tray", material="polypropylene")
    at = (x_top - 0.051, 0, top + 0.0005)
    shelf.add(box((0.14, 2 * inner - 0.06, 0.02)), at=at, by="front.bottom")
    hinge = (at[0], 0, at[2] + 0.02)
    obj.revolute("tray_fold", frame, shelf, at=hinge, axis=(0, 1, 0), range=(0, 1.1), friction=1.5)
