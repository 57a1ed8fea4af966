# Label: pliers
# PartNet-Mobility: Pliers
from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, sweep

depth = 0.2  # 0.16 to 0.24 m
width = 0.07  # 0.06 to 0.085 m
height = 0.014  # 0.012 to 0.018 m
jaws = "combination"  # one of combination, needle, blunt
latch = "yes"  # one of yes, no
grips = "red"  # one of red, blue, yellow, black

pliers = Object("pliers", label="pliers")
tones = {
    "red": (0.75, 0.1, 0.1),
    "blue": (0.12, 0.25, 0.65),
    "yellow": (0.9, 0.75, 0.1),
    "black": (0.14, 0.14, 0.15),
}
pliers.material("sleeve", like="pvc", rgb=tones[grips])
pliers.material("tool", like="steel", rgb=(0.45, 0.46, 0.48))
# They lie flat. The halves cross at the pivot, where each has half the thickness.
front, rear = depth / 2, -depth / 2
nose = {"combination": 0.22, "needle": 0.34, "blunt": 0.18}[jaws] * depth
b = 0.1 * width + 0.007
x = front - nose - b
tip = {"combination": 0.6, "needle": 0.22, "blunt": 0.9}[jaws] * b
half = 0.5 * height - 0.0003


def plate(part, points, sign, thick, z):
    """Add an outline of (x, y), mirrored for the upper half, whose jaw is at -y."""
    outline = [(px, sign * py) for px, py in points]
    part.add(extrusion(outline if sign > 0 else outline[::-1], thick), at=(0, 0, z))


parts = []
for name, sign, z in (("lower", 1, half / 2), ("upper", -1, height - half / 2)):
    part = pliers.part(f"{name}_half", material="tool")
    part.add(cylinder(b, half), at=(x, 0, z))
    root = x + b + 0.0015
    jaw = [(root, 0.0004), (front, 0.0004), (front, tip), (x + 1.8 * b, 0.95 * b), (root, 0.9 * b)]
    plate(part, jaw, sign, height, height / 2)
    tongue = [(x, 0.0004), (root + 0.003, 0.0004), (root + 0.003, 0.85 * b), (x, 0.95 * b)]
    plate(part, tongue, sign, half, z)
    # The neck crosses to the other side in its own layer; the handle has the full thickness.
    far = x - 2.2 * b
    neck = [(x, -0.98 * b), (x, -0.3 * b), (far, -0.55 * b), (far, -1.45 * b)]
    plate(part, neck, sign, half, z)
    y = -sign * (width / 2 - 0.006)
    path = [
        (x - 1.9 * b, -sign * b, height / 2),
        ((far + rear) / 2, y, height / 2),
        (rear + 0.003, 0.75 * y, height / 2),
    ]
    grip = sweep(path, width=height, thickness=[0.011, 0.012, 0.012], smooth=3)
    part.add(grip, material="sleeve")
    parts.append(part)
lower, upper = parts
for part, z, by in ((lower, 0.0003, "bottom"), (upper, height - 0.0003, "top")):
    part.add(cylinder(0.45 * b, 0.0004), at=(x, 0, z), by=by, rgb=(0.75, 0.75, 0.75), role="visual")
pliers.revolute(
    "open", lower, upper, at=(x, 0, height / 2), axis=(0, 0, -1), range=(0, 0.5), friction=0.05
)
if latch == "yes":
    # A hook at the lower half's handle holds the other one; it is drawn turned away.
    hook = pliers.part("latch", material="tool")
    y = -0.75 * (width / 2 - 0.006) + 0.0053
    eye = (rear + 0.012, y + 0.0025, height / 2)
    hook.add(box((0.024, 0.004, 0.004)), at=(rear + 0.009, y, height / 2), by="back.right")
    pliers.revolute("latch_turn", lower, hook, at=eye, axis="up", range=(0, 1.2), friction=0.005)
