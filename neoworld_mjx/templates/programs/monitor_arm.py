# Label: monitor arm with a screen
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, rounded_box

depth = 0.42  # 0.34 to 0.52 m
width = 0.54  # 0.45 to 0.72 m
height = 0.5  # 0.44 to 0.6 m
mount = "base"  # one of base, clamp
back_shape = "flat"  # one of flat, bulge
colour = "silver"  # one of silver, black, white

SHADE = {"silver": (0.72, 0.73, 0.75), "black": (0.12, 0.12, 0.13), "white": (0.92, 0.92, 0.9)}
obj = Object("monitor_arm", label="monitor arm with a screen")
metal = obj.material("metal", like="aluminium", density=1500, rgb=SHADE[colour])
dark = obj.material("dark", like="abs", rgb=(0.08, 0.08, 0.09), density=350)
tall, thick = 0.6 * width, 0.028
screen_z = height - tall / 2
back, x = -depth / 2, depth / 2 - thick
base = obj.part("base", material="steel", mass=7)
R, LIFT = 0.3 * depth, 0.012
post_x, middle_x = back + 0.09, back + R
if mount == "base":
    base.add(cylinder(R, LIFT), at=(middle_x, 0, 0), by="bottom")
else:
    base.add(box((2 * R, 0.22, LIFT)), at=(middle_x, 0, 0), by="bottom")
    base.add(box((0.05, 0.07, 0.06)), at=(post_x, 0, 0), by="bottom")
column = screen_z - 0.08
base.add(cylinder(0.018, column), at=(post_x, 0, 0), by="bottom")

# Shoulder and elbow turn about uprights; the forearm lies above the upper arm and lifts.
upper = obj.part("upper_arm", material=metal)
side = 0.12
elbow = (post_x + 0.35 * (x - post_x), -side)
turn = math.atan2(elbow[1], elbow[0] - post_x)
long = math.hypot(side, elbow[0] - post_x)
z = column + 0.0005
upper.add(cylinder(0.026, 0.036), at=(post_x, 0, z), by="bottom")
middle = ((post_x + elbow[0]) / 2, elbow[1] / 2, z + 0.018)
upper.add(rounded_box((long, 0.034, 0.028), 0.006), at=middle, rpy=(0, 0, turn))
upper.add(cylinder(0.026, 0.036), at=(*elbow, z), by="bottom")
obj.revolute(
    "shoulder",
    base,
    upper,
    at=(post_x, 0, z),
    axis="top",
    range=(-1.2, 0.5),
    damping=1.0,
    friction=1.5,
)
yoke = obj.part("elbow", material=metal)
z += 0.0365
yoke.add(cylinder(0.026, 0.02), at=(*elbow, z), by="bottom")
wrist = (x - 0.075, 0.0)
out = wrist[0] - elbow[0]
way = math.atan2(-elbow[1], out)
for off in (-0.021, 0.021):
    at = (elbow[0] - off * math.sin(way), elbow[1] + off * math.cos(way), z)
    yoke.add(box((0.03, 0.006, 0.05)), at=at, rpy=(0, 0, way), by="bottom")
obj.revolute(
    "elbow_turn",
    upper,
    yoke,
    at=(*elbow, z),
    axis="top",
    range=(-0.6, 1.2),
    damping=1.0,
    friction=1.5,
)
fore = obj.part("forearm", material=metal)
pin = (elbow[0], elbow[1], z + 0.038)
across = (math.pi / 2, 0, 0)
fore.add(cylinder(0.011, 0.035), at=pin, rpy=(math.pi / 2, 0, way))
length = math.hypot(out, elbow[1])
centre = ((elbow[0] + wrist[0]) / 2, elbow[1] / 2, pin[2])
fore.add(rounded_box((length, 0.03, 0.03), 0.006), at=centre, rpy=(0, 0, way))
fore.add(cylinder(0.02, 0.03), at=(*wrist, pin[2]))
obj.revolute(
    "lift",
    yoke,
    fore,
    at=pin,
    axis=(math.sin(way), -math.cos(way), 0),
    range=(-0.08, 0.5),
    friction=25,
)
knuckle = obj.part("wrist", material=metal)
knuckle.add(cylinder(0.018, 0.02), at=(*wrist, pin[2] - 0.0155), by="top")
drop = pin[2] - 0.0255
knuckle.add(box((x - 0.034 - wrist[0], 0.02, 0.018)), at=(wrist[0], 0, drop), by="back")
obj.revolute(
    "swivel", fore, knuckle, at=(*wrist, drop), axis="top", range=(-0.5, 0.5), friction=0.5
)
plate = obj.part("plate", material=dark)
hinge = (x - 0.024, 0, drop)
plate.add(cylinder(0.0095, 0.04), at=hinge, rpy=across)
plate.add(box((0.016, 0.1, 0.1)), at=(x - 0.0005, 0, drop), by="front")
obj.revolute("tilt", knuckle, plate, at=hinge, axis=(0, -1, 0), range=(-0.2, 0.3), friction=6)
screen = obj.part("screen", material=dark)
if back_shape == "bulge":
    screen.add(box((0.012, 0.5 * width, 0.4 * tall)), at=(x, 0, screen_z), by="back")
screen.add(box((thick, width, tall)), at=(x, 0, screen_z), by="back")
face = box((0.001, width - 0.016, tall - 0.016))
screen.add(face, at=(x + thick, 0, screen_z), by="front", role="visual", rgb=(0.2, 0.32, 0.45))
obj.revolute("pivot", plate, screen, at=(x, 0, drop), axis="front", range=(0, 1.57), friction=3)
