# Label: toy ferris wheel
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, mirror, sweep, torus

depth = 0.22  # 0.18 to 0.28 m
width = 0.54  # 0.5 to 0.6 m
height = 0.48  # 0.4 to 0.5 m
seats = 8  # 5 to 9
seat_shape = "tub"  # one of tub, cabin
rim = "round"  # one of round, straight
colour = "red"  # one of red, blue, green, white

PAINT = {"red": (0.78, 0.15, 0.12), "blue": (0.15, 0.32, 0.68), "green": (0.2, 0.5, 0.28)}
TINTS = [(0.9, 0.3, 0.2), (0.95, 0.8, 0.2), (0.25, 0.55, 0.85), (0.4, 0.7, 0.35)]
obj = Object("ferris_wheel", label="toy ferris wheel")
paint = obj.material("paint", like="abs", rgb=PAINT.get(colour, (0.92, 0.92, 0.9)))
BASE, RING = 0.016, 0.004
R = (height - BASE - 0.02 - RING) / 2.34
hub_z = height - R - RING
half = 0.24 * depth
along = (0, math.pi / 2, 0)
stand = obj.part("stand", material="pine")
stand.add(box((depth, width, BASE)), by="bottom")
for x in (-half - 0.018, half + 0.018):
    for y in mirror((0, 0.55 * R, 0)):
        leg = [(x, y[1], BASE - 0.003), (x, 0, hub_z)]
        stand.add(sweep(leg, width=0.012, thickness=0.014))
    stand.add(cylinder(0.014, 0.012), at=(x, 0, hub_z), rpy=along)

wheel = obj.part("wheel", material=paint)
wheel.add(cylinder(0.008, 2 * half + 0.02), at=(0, 0, hub_z), rpy=along)
places = [2 * math.pi * (k + 0.5) / seats for k in range(seats)]
for x in (-half, half):
    if rim == "round":
        wheel.add(torus(R, RING, sectors=6), at=(x, 0, hub_z), rpy=along)
    else:
        corners = [(x, R * math.sin(t), hub_z + R * math.cos(t)) for t in places]
        wheel.add(sweep(corners, radius=RING, closed=True))
        # A round hoop carries the straight rims, and reaches the height of the box.
        wheel.add(torus(R, 0.5 * RING, sectors=6), at=(x, 0, hub_z), rpy=along)
    for t in places:
        end = (x, R * math.sin(t), hub_z + R * math.cos(t))
        wheel.add(sweep([(x, 0, hub_z), end], width=0.006, thickness=0.006))
    wheel.add(cylinder(0.022, 0.008), at=(x, 0, hub_z), rpy=along)
turn = obj.continuous("wheel_turn", stand, wheel, at=(0, 0, hub_z), axis="front")

# Seats hang between the two rims, each on its pin, and stay level by their weight.
reach = min(0.27 * R, 0.8 * R * math.sin(math.pi / seats))
for k, t in enumerate(places):
    seat = obj.part(f"seat_{k + 1}", material="plastic")
    tint = TINTS[k % len(TINTS)]
    y, z = R * math.sin(t), hub_z + R * math.cos(t)
    long, wide = 2 * half - 2 * RING - 0.001, 0.95 * reach
    seat.add(cylinder(0.003, long), at=(0, y, z), rpy=along, material="steel")
    tub = hollow_box((long - 0.004, wide, 0.45 * reach), 0.003)
    seat.add(tub, at=(0, y, z - 0.88 * reach), by="bottom", rgb=tint)
    for x in (-long / 2 + 0.005, long / 2 - 0.005):
        seat.add(box((0.004, 0.01, 0.85 * reach)), at=(x, y, z + 0.004), by="top", rgb=tint)
    if seat_shape == "cabin":
        seat.add(
            box((long - 0.004, 0.8 * wide, 0.004)), at=(0, y, z + 0.004), rgb=(0.95, 0.95, 0.92)
        )
    obj.continuous(f"seat_{k + 1}_hang", wheel, seat, at=(0, y, z), axis="front")
