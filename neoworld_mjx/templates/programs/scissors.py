# Label: scissors
# PartNet-Mobility: Scissors
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, sweep

depth = 0.2  # 0.15 to 0.25 m
width = 0.085  # 0.075 to 0.1 m
height = 0.011  # 0.009 to 0.014 m
blades = "straight"  # one of straight, short, curved
screw = "knob"  # one of knob, slot
colour = "orange"  # one of orange, black, blue, red

scissors = Object("scissors", label="scissors")
tones = {
    "orange": (0.9, 0.4, 0.08),
    "black": (0.13, 0.13, 0.14),
    "blue": (0.15, 0.3, 0.65),
    "red": (0.7, 0.1, 0.12),
}
scissors.material("grip", like="abs", rgb=tones[colour])
# They lie flat, one blade on the other; each blade goes over into the ring of the other side.
front, rear = depth / 2, -depth / 2
x = front - depth * (0.42 if blades == "short" else 0.54)
t, b = 0.0024, 0.1 * width + 0.002
long, ring_x = 0.36 * (x - rear), 0.5 * width - 0.008
halves = []
for name, sign, low in (("lower", 1, 0.0), ("upper", -1, t + 0.0005)):
    half = scissors.part(f"{name}_half", material="stainless_steel")
    z = low + t / 2
    bow = 0.35 * b if blades == "curved" else 0.0
    edge = [(x - b, -0.7 * b), (x + 0.4 * (front - x), -0.25 * b + bow), (front, 0.0005 + bow)]
    spine = [(x + 0.5 * (front - x), 0.85 * b + bow), (x, b), (x - b, 0.7 * b)]
    outline = [(px, sign * py) for px, py in edge + spine]
    half.add(extrusion(outline if sign > 0 else outline[::-1], t), at=(0, 0, z))
    # The shank runs to the other side, where the ring has the full height.
    centre = (rear + long, -sign * (width / 2 - 0.235 * width))
    near, yc = centre[0] + 0.8 * long, -0.25 * width
    shank = [
        (near, yc - 0.5 * b),
        (x - 0.3 * b, -0.7 * b),
        (x - 0.3 * b, 0.6 * b),
        (near, yc + 0.6 * b),
    ]
    outline = [(px, sign * py) for px, py in shank]
    half.add(extrusion(outline if sign > 0 else outline[::-1], t), at=(0, 0, z))
    loop = []
    for k in range(20):
        a = math.pi * k / 10
        loop.append(
            (
                centre[0] + (long - 0.0035) * math.cos(a),
                centre[1] + (0.235 * width - 0.0035) * math.sin(a),
                height / 2,
            )
        )
    half.add(sweep(loop, width=height, thickness=0.007, closed=True), material="grip")
    halves.append(half)
lower, upper = halves
scissors.revolute(
    "open", lower, upper, at=(x, 0, t), axis=(0, 0, -1), range=(0, 0.7), friction=0.02
)
pin = scissors.part("screw", material="steel")
top = 2 * t + 0.0005
spot = (x, 0, top + 0.0004)
pin.add(cylinder(0.5 * b, 0.0018), at=spot, by="bottom", rgb=(0.7, 0.7, 0.72))
if screw == "knob":
    pin.add(
        box((0.8 * b, 0.0016, 0.0022)), at=(x, 0, top + 0.0018), by="bottom", rgb=(0.2, 0.2, 0.2)
    )
else:
    slot = box((0.8 * b, 0.001, 0.0004))
    pin.add(slot, at=(x, 0, top + 0.002), by="bottom", rgb=(0.2, 0.2, 0.2), role="visual")
scissors.continuous("screw_turn", upper, pin, at=spot, axis="up")
