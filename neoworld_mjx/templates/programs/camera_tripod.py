# Label: camera tripod
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box, sphere, sweep

depth = 0.6  # 0.5 to 0.75 m
width = 0.66  # 0.58 to 0.8 m
height = 1.2  # 0.9 to 1.5 m
camera = "none"  # one of none, box
feet = "rubber"  # one of rubber, spike
finish = "black"  # one of black, silver, oak

LOOK = {"black": (0.13, 0.13, 0.14), "silver": (0.72, 0.73, 0.75), "oak": (0.62, 0.45, 0.28)}
obj = Object("camera_tripod", label="camera tripod")
leg_stuff = obj.material(
    "leg", like="oak" if finish == "oak" else "aluminium", density=700, rgb=LOOK[finish]
)
dark = obj.material("dark", like="abs", rgb=(0.12, 0.12, 0.13))
TOP = 0.17 if camera == "none" else 0.24
hub_z = height - TOP - 0.1
# One foot stands in front, two behind; the box gives how far they are apart.
feet_at = [
    (depth / 2 - 0.012, 0.0),
    (-depth / 2 + 0.012, width / 2 - 0.012),
    (-depth / 2 + 0.012, -width / 2 + 0.012),
]
hub_x = -0.15 * depth
body = obj.part("hub", material=dark)
body.add(cylinder(0.032, 0.05), at=(hub_x, 0, hub_z), by="centre")


def along(start, down, s, off=0.0):
    """Return the point s further down a leg and off beside its middle."""
    side = math.hypot(down[0], down[1])
    across = (-off * down[1] / side, off * down[0] / side, 0)
    return tuple(a + s * d + o for a, d, o in zip(start, down, across, strict=True))


for k, (fx, fy) in enumerate(feet_at):
    t = math.atan2(fy, fx - hub_x)
    u = (math.cos(t), math.sin(t))
    start = (hub_x + 0.045 * u[0], 0.045 * u[1], hub_z)
    lug = (hub_x + 0.03 * u[0], 0.03 * u[1], hub_z)
    body.add(box((0.03, 0.012, 0.03)), at=lug, rpy=(0, 0, t))
    out = math.hypot(fx - start[0], fy - start[1])
    lean = math.atan2(out, hub_z - 0.006)
    long = math.hypot(out, hub_z - 0.006)
    down = (math.sin(lean) * u[0], math.sin(lean) * u[1], -math.cos(lean))
    turned = (0, -lean, t)
    upper = obj.part(f"leg_{k + 1}", material=leg_stuff)
    half = 0.6 * long
    for off in (-0.013, 0.013):
        upper.add(box((0.018, 0.01, half)), at=along(start, down, half / 2, off), rpy=turned)
    upper.add(box((0.012, 0.036, 0.02)), at=along(start, down, 0.4 * half), rpy=turned)
    clamp = along(start, down, half - 0.012)
    for side in (-0.0115, 0.0115):
        place = (
            clamp[0] + side * math.cos(lean) * u[0],
            clamp[1] + side * math.cos(lean) * u[1],
            clamp[2] + side * math.sin(lean),
        )
        upper.add(box((0.005, 0.036, 0.024)), at=place, rpy=turned, material=dark)
    axis = (-u[1], u[0], 0)
    obj.revolute(
        f"fold_{k + 1}", body, upper, at=start, axis=axis, range=(0, 0.8 * lean), friction=0.6
    )
    lower = obj.part(f"extension_{k + 1}", material=leg_stuff)
    low = 0.55 * half
    lower.add(box((0.016, 0.0145, long - low)), at=along(start, down, (low + long) / 2), rpy=turned)
    foot = (fx, fy, 0)
    if feet == "rubber":
        lower.add(sphere(0.012), at=foot, by="bottom", material="rubber")
    else:
        lower.add(cylinder(0.012, 0.008), at=foot, by="bottom", material="steel")
    obj.prismatic(f"extend_{k + 1}", upper, lower, axis=down, range=(0, 0.3 * half), friction=6)

column = obj.part("column", material=leg_stuff)
post_z = hub_z + 0.0255
column.add(cylinder(0.013, 0.07), at=(hub_x, 0, post_z), by="bottom")
column.add(cylinder(0.025, 0.02), at=(hub_x, 0, post_z + 0.065), by="bottom", material=dark)
obj.prismatic("column_lift", body, column, axis="top", range=(0, 0.06), friction=12)
knob = obj.part("column_lock", material=dark)
side = (hub_x - 0.0325, 0, hub_z + 0.01)
knob.add(cylinder(0.011, 0.018), at=side, rpy=(0, math.pi / 2, 0), by="front")
obj.continuous("column_lock_turn", body, knob, at=side, axis="back")
head = obj.part("head", material=dark)
socket = post_z + 0.0855
ball = (hub_x, 0, socket + 0.02)
head.add(sphere(0.02), at=ball)
head.add(cylinder(0.011, 0.035), at=(hub_x, 0, ball[2] + 0.01), by="bottom")
plate_z = ball[2] + 0.045
if camera == "none":
    head.add(box((0.06, 0.05, height - plate_z)), at=(hub_x, 0, height), by="top")
else:
    head.add(box((0.06, 0.05, 0.008)), at=(hub_x, 0, plate_z - 0.002), by="bottom")
    low = plate_z + 0.005
    head.add(
        rounded_box((0.045, 0.13, height - low - 0.012), 0.005), at=(hub_x, 0, low), by="bottom"
    )
    head.add(cylinder(0.012, 0.013), at=(hub_x, 0.04, height), by="top", material="steel")
    lens_z = (low + height) / 2 - 0.006
    lens = cylinder(0.03, 0.06)
    head.add(lens, at=(hub_x + 0.022, 0, lens_z), rpy=(0, math.pi / 2, 0), by="back")
    head.add(
        cylinder(0.024, 0.001),
        at=(hub_x + 0.0825, 0, lens_z),
        rpy=(0, math.pi / 2, 0),
        role="visual",
        rgb=(0.3, 0.35, 0.5),
    )
head.add(sweep([(hub_x, 0, plate_z), (hub_x - 0.12, 0.0, plate_z - 0.03)], radius=0.006))
obj.ball("head_ball", column, head, at=ball, swing=0.35, friction=2.5)
