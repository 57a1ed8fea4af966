# Label: bread bin
import math

from neoworld_mjx.program.sdk import Object, box, extrusion

depth = 0.3  # 0.24 to 0.36 m
width = 0.4  # 0.3 to 0.5 m
height = 0.2  # 0.16 to 0.24 m
front = "roll"  # one of roll, flap
finish = "steel"  # one of steel, cream, bamboo
board = "drawer"  # one of drawer, none

FINISH = {"steel": (0.72, 0.73, 0.75), "cream": (0.9, 0.85, 0.7), "bamboo": (0.8, 0.66, 0.42)}
WALL, GRIP = 0.006, 0.016
obj = Object("bread_bin", label="bread bin")
sheet = obj.material("sheet", like="bamboo" if finish == "bamboo" else "aluminium",
                     density=900, rgb=FINISH[finish])  # fmt: skip
lift = 0.034 if board == "drawer" else 0.0
tall, x, back = height - lift, depth / 2 - GRIP, -depth / 2
radius = min(0.68 * tall, (x - back) / 2 - 0.01)
cx, cz = x - radius, height - radius
upright = (math.pi / 2, 0, 0)


def arc(r, first, last):
    """Points of an arc in (x, z) about the roll's axis; angles from the front, in degrees."""
    turns = [math.radians(first + (last - first) * k / 8) for k in range(9)]
    return [(cx + r * math.cos(t), cz + r * math.sin(t)) for t in turns]


body = obj.part("body", material=sheet)
if front == "roll":
    cheek = [(back, lift), (x, lift), *arc(radius, 0, 90), (back, height)]
else:
    cheek = [(back, lift), (x, lift), (x - 0.3 * tall, height), (back, height)]
for y in (-width / 2 + WALL / 2, width / 2 - WALL / 2):
    body.add(extrusion(cheek, WALL), at=(0, y, 0), rpy=upright)
wide = width - 2 * WALL
body.add(box((x - back, wide, WALL)), at=(back, 0, lift), by="back.bottom")
body.add(box((WALL, wide, tall)), at=(back, 0, lift), by="back.bottom")
if front == "roll":
    body.add(box((cx - back, wide, 0.004)), at=(back, 0, height), by="back.top")
    body.add(box((0.004, wide, cz - lift)), at=(x, 0, lift), by="front.bottom")
    door = obj.part("shutter", material=sheet)
    sector = arc(radius - 0.0055, 2, 96) + arc(radius - 0.0095, 96, 2)
    door.add(extrusion(sector, wide - 0.001), rpy=upright)
    z = cz + 0.22 * radius
    at = (depth / 2, 0, z)
    door.add(box((GRIP + 0.014, 0.3 * wide, 0.014)), at=at, by="front", material="walnut")
    for y in (-wide / 2 + 0.0025, wide / 2 - 0.0025):
        arm = [(cx - 0.008, cz), (cx, cz - 0.008), *arc(radius - 0.007, 20, 60)]
        door.add(extrusion(arm, 0.004), at=(0, y, 0), rpy=upright)
    obj.revolute("roll", body, door, at=(cx, 0, cz), axis=(0, -1, 0), range=(0, 1.15), friction=0.6)
else:
    # The front leans back; it turns forward about its lower edge.
    lean = math.atan2(0.3 * tall, tall)
    body.add(box((x - 0.3 * tall - back, wide, 0.004)), at=(back, 0, height), by="back.top")
    door = obj.part("flap", material=sheet)
    slope = tall / math.cos(lean)
    out = (math.cos(lean) * 0.0045, math.sin(lean) * 0.0045)
    middle = (x - 0.15 * tall + out[0], 0, lift + tall / 2 + out[1])
    door.add(box((0.008, width - 0.002, slope - 0.012)), at=middle, rpy=(0, -lean, 0))
    grip = (depth / 2, 0, lift + 0.5 * tall)
    bar = box((depth / 2 - middle[0] - 0.002, 0.3 * wide, 0.012))
    door.add(bar, at=grip, by="front", material="walnut")
    foot = (x + 2 * out[0], 0, lift + 0.008)
    obj.revolute("flap", body, door, at=foot, axis=(0, 1, 0), range=(0, 1.4), opens="front")

if board == "drawer":
    # Below stands a frame in which the cutting board runs.
    for y in (-width / 2 + 0.009, width / 2 - 0.009):
        body.add(box((x - back, 0.018, lift)), at=(back, y, 0), by="back.bottom")
    body.add(box((x - back, width, 0.005)), at=(back, 0, 0), by="back.bottom")
    plank = obj.part("cutting_board", material="bamboo")
    size = (x - back - 0.004, width - 0.04, lift - 0.0075)
    plank.add(box(size), at=(x, 0, 0.006), by="front.bottom")
    plank.add(box((0.01, 0.1, 0.012)), at=(x, 0, lift / 2), by="back")
    obj.prismatic("board_slide", body, plank, axis="front", range=(0, 0.6 * size[0]), opens="front")
