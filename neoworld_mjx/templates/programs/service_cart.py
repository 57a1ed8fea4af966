# Label: service cart
# PartNet-Mobility: Cart
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, sweep

depth = 0.75  # 0.6 to 0.9 m
width = 0.45  # 0.38 to 0.6 m
height = 0.9  # 0.8 to 1.0 m
shelves = 3  # 2 to 3
drawers = 1  # 0 to 2
kind = "tray"  # one of tray, board
colour = "steel"  # one of steel, red, black, pine

WHEEL, TUBE, LIFT, FRONT, GRIP = 0.05, 0.012, 0.15, 0.016, 0.09
across = (math.pi / 2, 0, 0)
cart = Object("service_cart", label="service cart")
shade = {
    "steel": (0.72, 0.74, 0.76),
    "red": (0.7, 0.12, 0.12),
    "black": (0.15, 0.15, 0.16),
    "pine": (0.8, 0.64, 0.42),
}
cart.material("deck", like="pine" if colour == "pine" else "aluminium", rgb=shade[colour])
body = cart.part("frame", material="deck")
# The push handle stands out behind; drawers under the top open to the front.
x, back = depth / 2 - FRONT - 0.02, -depth / 2 + GRIP
deep, middle = x - back, (x + back) / 2
corners = [
    (cx, cy) for cx in (x - TUBE, back + TUBE) for cy in (-width / 2 + 0.02, width / 2 - 0.02)
]
top = height - 0.06 if kind == "tray" else height - 0.03
store = 0.12 if drawers else 0
for cx, cy in corners:
    body.add(
        cylinder(TUBE, top - LIFT - store + 0.002), at=(cx, cy, LIFT), by="bottom", material="steel"
    )
for k in range(shelves):
    z = LIFT + 0.02 + k * (top - LIFT - 0.02) / (shelves - 1)
    if kind == "tray":
        body.add(hollow_box((deep, width, 0.06), 0.003), at=(middle, 0, z), by="bottom")
    else:
        body.add(box((deep, width, 0.03)), at=(middle, 0, z), by="bottom")
if drawers:
    body.add(
        hollow_box((deep, width, store), 0.004, open="+x"), at=(middle, 0, top + 0.001), by="top"
    )
    step = (width - 0.008) / drawers
    for k in range(drawers):
        y = (-width / 2 + 0.004 + k * step, -width / 2 + 0.004 + (k + 1) * step)
        tray = cart.drawer(
            f"drawer_{k + 1}",
            body,
            x=x,
            y=y,
            z=(top - store + 0.006, top - 0.003),
            depth=0.9 * deep,
            wall=0.004,
            front=FRONT,
        )
        at = (x + FRONT - 0.002, (y[0] + y[1]) / 2, top - 0.03)
        tray.add(box((0.022, 0.4 * step, 0.012)), at=at, by="back", rgb=(0.3, 0.3, 0.32))
else:
    body.add(
        box((FRONT + 0.022, width, 0.03)),
        at=(x - 0.002, 0, top),
        by="back.top",
        rgb=(0.2, 0.2, 0.21),
    )
grip = height - 0.016
bar = [
    (back + 0.003, -width / 2 + 0.03, grip - 0.06),
    (-depth / 2 + 0.02, -width / 2 + 0.03, grip),
    (-depth / 2 + 0.014, -width / 2 + 0.06, grip + 0.004),
    (-depth / 2 + 0.014, width / 2 - 0.06, grip + 0.004),
    (-depth / 2 + 0.02, width / 2 - 0.03, grip),
    (back + 0.003, width / 2 - 0.03, grip - 0.06),
]
body.add(sweep(bar, radius=0.012), material="steel")
# Casters: the forks of the front pair swivel, those behind have brakes.
for k, (cx, cy) in enumerate(corners):
    front = k < 2
    fork = cart.part(f"fork_{k + 1}", material="steel") if front else body
    plate = LIFT - 0.0008 if front else LIFT + 0.001
    trail = 0.02 if front else 0.0
    hub = (cx - trail, cy, WHEEL)
    fork.add(cylinder(0.014, 0.02), at=(cx, cy, plate), by="top", material="steel")
    crown = 2 * WHEEL + 0.006
    fork.add(
        box((0.05, 0.038, plate - 0.018 - crown)),
        at=(cx - trail / 2, cy, crown),
        by="bottom",
        material="steel",
    )
    for side in (-0.0165, 0.0165):
        cheek = (cx - trail, cy + side, WHEEL - 0.012)
        fork.add(box((0.03, 0.005, crown - WHEEL + 0.014)), at=cheek, by="bottom", material="steel")
    if front:
        cart.continuous(f"swivel_{k + 1}", body, fork, at=(cx, cy, LIFT), axis="up")
    wheel = cart.part(f"wheel_{k + 1}", material="rubber")
    wheel.add(cylinder(WHEEL, 0.025), at=hub, rpy=across, rgb=(0.16, 0.16, 0.17))
    for side in (-0.0128, 0.0128):
        disc = cylinder(0.5 * WHEEL, 0.0005)
        wheel.add(
            disc,
            at=(hub[0], hub[1] + side, hub[2]),
            rpy=across,
            rgb=(0.6, 0.6, 0.62),
            role="visual",
        )
    cart.continuous(f"roll_{k + 1}", fork, wheel, at=hub, axis="left", friction=0.04)
    if not front:
        brake = cart.part(f"brake_{k + 1}", material="abs")
        at = (cx - 0.0258, cy, 2 * WHEEL + 0.012)
        brake.add(box((0.045, 0.03, 0.006)), at=at, by="front", rgb=(0.7, 0.1, 0.1))
        cart.revolute(
            f"brake_press_{k + 1}",
            body,
            brake,
            at=at,
            axis=(0, -1, 0),
            range=(0, 0.3),
            friction=0.05,
        )
