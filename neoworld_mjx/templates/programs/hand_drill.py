# Label: hand drill
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, difference, frustum, lathe, sphere

depth = 0.32  # 0.26 to 0.4 m
width = 0.12  # 0.1 to 0.15 m
height = 0.12  # 0.11 to 0.14 m
spokes = 4  # 3 to 6
side_grip = "knob"  # one of knob, none
wood = "oak"  # one of oak, walnut, pine
wheel = "red"  # one of red, green, black

# It lies on its side: the shaft runs to the front, the gear wheel turns above it.
PAINT = {"red": (0.72, 0.12, 0.1), "green": (0.15, 0.4, 0.22), "black": (0.12, 0.12, 0.13)}
obj = Object("hand_drill", label="hand drill")
paint = obj.material("paint", like="cast_iron", density=4000, rgb=PAINT[wheel])
back, front, axis_z = -depth / 2, depth / 2, 0.0205
along, R = (0, math.pi / 2, 0), (0.42 if side_grip == "knob" else 0.5) * width
body = obj.part("frame", material="steel")
grip_long = 0.32 * depth
grip = lathe([(0, 0), (0.016, 0), (0.019, 0.25 * grip_long), (0.015, 0.7 * grip_long),
              (0.02, 0.9 * grip_long), (0.017, grip_long)])  # fmt: skip
body.add(grip, at=(back + grip_long, 0, axis_z), rpy=(0, -math.pi / 2, 0), material=wood)
nose = front - 0.3 * depth
for y in (-0.017, 0.017):
    rail = box((nose - back - grip_long, 0.008, 0.014))
    body.add(rail, at=(nose, y, axis_z), by="front")
for x in (back + grip_long + 0.004, nose - 0.004):
    bush = difference(box((0.012, 0.042, 0.03)), cylinder(0.0065, 0.1).moved(rpy=along))
    body.add(bush, at=(x, 0, axis_z))
gear_x = nose - 0.04 - 0.9 * R
body.add(box((0.03, 0.05, 0.006)), at=(gear_x, 0, 0), by="bottom")
for y in (-0.02, 0.02):
    body.add(box((0.03, 0.006, axis_z)), at=(gear_x, y, 0), by="bottom")
top = axis_z + 0.016
for y in (-0.017, 0.017):
    body.add(box((0.016, 0.008, 0.014)), at=(gear_x, y, top), by="top")
body.add(box((0.016, 0.034, 0.005)), at=(gear_x, 0, top), by="top")
if side_grip == "knob":
    stem = cylinder(0.005, width / 2 - 0.034)
    body.add(stem, at=(gear_x - 0.02, 0.018, axis_z), rpy=(math.pi / 2, 0, 0), by="right")
    knob = sphere(0.018)
    body.add(knob, at=(gear_x - 0.02, width / 2, axis_z), by="left", material=wood)

gear = obj.part("gear", material=paint)
z = top + 0.0005
gear.add(cylinder(0.012, 0.014), at=(gear_x, 0, z), by="bottom")
rim = difference(cylinder(R, 0.007), cylinder(0.8 * R, 0.1), sectors=24)
gear.add(rim, at=(gear_x, 0, z + 0.004), by="bottom")
for k in range(spokes):
    t = 2 * math.pi * k / spokes
    at = (gear_x + 0.42 * R * math.cos(t), 0.42 * R * math.sin(t), z + 0.004)
    gear.add(box((0.85 * R, 0.011, 0.006)), at=at, rpy=(0, 0, t), by="bottom")
reach, high = width / 2 - 0.012, height - 0.034
gear.add(cylinder(0.008, high - z), at=(gear_x, 0, z), by="bottom", material="steel")
crank = box((0.012, reach + 0.004, 0.006))
gear.add(crank, at=(gear_x, 0.004, high), by="left.top", material="steel")
gear.add(cylinder(0.008, 0.006), at=(gear_x, -reach, high), by="top", material="steel")
turn = obj.continuous("crank_turn", body, gear, at=(gear_x, 0, z), axis="top")
handle = obj.part("crank_handle", material=wood)
pull = height - high - 0.0005
outline = [(0, 0), (0.008, 0), (0.011, 0.6 * pull), (0.007, pull)]
handle.add(lathe(outline), at=(gear_x, -reach, high + 0.0005))
obj.continuous("handle_turn", gear, handle, at=(gear_x, -reach, high), axis="top")

shaft = obj.part("chuck", material="steel")
rear = back + grip_long + 0.0005
shaft.add(cylinder(0.006, nose + 0.004 - rear), at=(rear, 0, axis_z), rpy=along, by="back")
pinion = frustum(0.013, 0.009, 0.012)
shaft.add(
    pinion, at=(gear_x + 0.9 * R + 0.002, 0, axis_z), rpy=(0, -math.pi / 2, 0), material="brass"
)
shaft.add(cylinder(0.016, 0.03), at=(nose + 0.0035, 0, axis_z), rpy=along, by="back")
shaft.add(frustum(0.016, 0.008, 0.026), at=(nose + 0.033, 0, axis_z), rpy=along, by="back")
bit = cylinder(0.003, front - nose - 0.055)
shaft.add(bit, at=(front, 0, axis_z), rpy=along, by="front")
obj.continuous(
    "chuck_turn", body, shaft, at=(nose, 0, axis_z), axis="front", mimic=turn, multiplier=4
)
