# Label: cash register
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, hollow_box, rounded_box

depth = 0.42  # 0.36 to 0.5 m
width = 0.38  # 0.32 to 0.48 m
height = 0.36  # 0.3 to 0.46 m
rows = 3  # 2 to 4
columns = 4  # 3 to 5
top = "display"  # one of display, printer
colour = "grey"  # one of grey, black, cream

SHADE = {"grey": (0.35, 0.36, 0.38), "black": (0.1, 0.1, 0.11), "cream": (0.85, 0.82, 0.74)}
CHEST, WALL, PULL, FRONT = 0.11, 0.006, 0.008, 0.012
obj = Object("cash_register", label="cash register")
case = obj.material("case", like="abs", density=450, rgb=SHADE[colour])
x, back = depth / 2 - FRONT - PULL, -depth / 2
body = obj.part("body", material=case)
body.add(hollow_box((x - back, width, CHEST), WALL, open="+x"), at=(x, 0, 0), by="front.bottom")
till = obj.drawer(
    "till", body, x=x, y=(-width / 2 + WALL, width / 2 - WALL), z=(WALL, CHEST - WALL),
    depth=0.88 * (x - back), wall=0.004, front=FRONT, overlay=0.004, material=case,
)  # fmt: skip
till.add(box((PULL + 0.002, 0.12, 0.012)), at=(depth / 2, 0, 0.09), by="front.top")
inner = width / 2 - 0.015
for k in range(3):
    rib = box((0.4 * (x - back), 0.003, 0.05))
    till.add(rib, at=(x - 0.008, inner * (k - 1) * 0.66, 0.008), by="front.bottom")
till.add(cylinder(0.008, 0.004), at=(x + FRONT - 0.001, 0.3 * width, 0.05),
         rpy=(0, math.pi / 2, 0), by="back", material="steel")  # fmt: skip

# The keyboard lies on a slope that rises to the back of the machine.
low, high = CHEST + 0.03, CHEST + 0.13
run = 0.55 * depth
a = math.atan2(high - low, run)
wedge = [(x, CHEST), (x, low), (x - run, high), (back + 0.02, high), (back + 0.02, CHEST)]
body.add(extrusion(wedge, width - 0.02), rpy=(math.pi / 2, 0, 0))
pitch = min(0.036, 0.8 * run / rows)
across = pitch + 0.006
for j in range(columns + 1):
    # Ribs between the keys guide them.
    rib = box((rows * pitch + 0.01, 0.0046, 0.016))
    at = (x - 0.45 * run * math.cos(a), -0.06 * width + (j - columns / 2) * across)
    body.add(rib, at=(*at, low + 0.45 * run * math.sin(a)), rpy=(0, a, 0))
for i in range(rows):
    for j in range(columns):
        up = 0.45 * run + (i - (rows - 1) / 2) * pitch
        y = -0.06 * width + (j - (columns - 1) / 2) * across
        key = obj.part(f"key_{i + 1}_{j + 1}", material="plastic")
        tint = (0.75, 0.2, 0.15) if j == columns - 1 else (0.92, 0.92, 0.88)
        cap = rounded_box((pitch - 0.006, pitch, 0.012), 0.003)
        at = (x - up * math.cos(a), y, low + up * math.sin(a))
        out = (math.sin(a) * 0.0115, 0, math.cos(a) * 0.0115)
        centre = (at[0] + out[0], y, at[2] + out[2])
        key.add(cap, at=centre, rpy=(0, a, 0), rgb=tint)
        down, press = (-math.sin(a), 0, -math.cos(a)), f"press_{i + 1}_{j + 1}"
        obj.prismatic(press, body, key, axis=down, range=(0, 0.004), friction=0.5)

# A head on a column turns towards the customer, or a printer has a cover over its roll.
if top == "display":
    neck = cylinder(0.016, height - high - 0.085)
    at = (back + 0.08, 0.2 * width, high)
    column = body.add(neck, at=at, by="bottom")
    head = obj.part("display", material=case)
    z = column.anchor("top")[2] + 0.0005
    head.add(box((0.05, 0.5 * width, height - z)), at=(at[0], at[1], z), by="bottom")
    screen = box((0.001, 0.44 * width, 0.6 * (height - z)))
    head.add(
        screen,
        at=(at[0] + 0.025, at[1], (z + height) / 2),
        by="back",
        role="visual",
        rgb=(0.2, 0.8, 0.7),
    )
    obj.revolute("display_turn", body, head, at=at, axis=(0, 0, 1), range=(-1.2, 1.2))
else:
    size = (0.14, 0.4 * width, height - high - 0.004)
    at = (back + 0.03, 0.22 * width, high)
    house = body.add(hollow_box(size, 0.004), at=at, by="back.bottom")
    roll = obj.part("paper_roll", material="paper")
    r = min(0.03, 0.4 * size[2])
    centre = (back + 0.1, at[1], high + 0.0045 + r)
    roll.add(cylinder(r, size[1] - 0.0095), at=centre, rpy=(math.pi / 2, 0, 0))
    obj.continuous("roll_turn", body, roll, at=centre, axis=(0, 1, 0))
    lid = obj.part("printer_cover", material=case)
    lid.add(box((size[0], size[1], 0.0035)), at=house.anchor("back.top"), by="back.bottom")
    lid.add(
        box((0.06, 0.003, 0.0005)), at=lid.anchor("top"), by="top", role="visual", rgb=(0, 0, 0)
    )
    obj.revolute("cover", body, lid, at="back.hinge", range=(0, 1.6))
