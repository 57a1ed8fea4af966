# Label: globe
# PartNet-Mobility: Globe
import math

from neoworld_mjx.program.sdk import Object, cylinder, frustum, lathe, sphere, sweep

depth = 0.24  # 0.22 to 0.3 m
width = 0.24  # 0.22 to 0.3 m
height = 0.36  # 0.32 to 0.46 m
mount = "half"  # one of half, ring
foot = "disc"  # one of disc, bell
sea = "blue"  # one of blue, antique, dark

globe = Object("desk_globe", label="globe")
water = {"blue": (0.2, 0.45, 0.75), "antique": (0.85, 0.75, 0.55), "dark": (0.1, 0.14, 0.2)}[sea]
land = {"blue": (0.35, 0.6, 0.25), "antique": (0.6, 0.42, 0.22), "dark": (0.72, 0.6, 0.3)}[sea]
globe.material(
    "metal", like="aluminium", rgb=(0.78, 0.62, 0.28) if sea != "dark" else (0.6, 0.6, 0.62)
)
base = globe.part("base", material="walnut", mass=1.8)
r, oval = depth / 2, width / depth
BAR, GAP, TILT, KNOB = 0.005, 0.009, 0.41, 0.014
# The knob on the north pole is the highest point, or the ring's top.
mean = min(0.42 * min(depth, width), 0.34 * height)
radius = mean - BAR - GAP
top = max(
    (mean + BAR + KNOB) * math.cos(TILT) + 0.006 * math.sin(TILT),
    mean + BAR if mount == "ring" else 0,
)
centre = height - top
if foot == "disc":
    profile = [(0, 0), (r, 0), (r, 0.014), (0.5 * r, 0.022)]
else:
    profile = [(0, 0), (r, 0), (0.92 * r, 0.014), (0.35 * r, 0.045)]
base.add(lathe(profile, sectors=24, oval=oval))
rise, yoke = profile[-1][1] - 0.001, centre - mean - BAR
base.add(cylinder(0.009, yoke - rise - 0.002), at=(0, 0, rise), by="bottom", material="metal")
base.add(frustum(0.02, 0.012, 0.02), at=(0, 0, rise), by="bottom", material="metal")
for y in (-0.0095, 0.0095):
    cheek = cylinder(0.012, 0.006)
    base.add(cheek, at=(0, y, yoke + 0.002), rpy=(math.pi / 2, 0, 0), material="metal")
base.add(cylinder(0.0125, 0.006), at=(0, 0, yoke - 0.0015), by="top", material="metal")

# The meridian tips in the clamp on the stem; the sphere turns about the tilted axis of the poles.
meridian = globe.part("meridian", material="metal")
pole = (math.sin(TILT), 0, math.cos(TILT))


def on_axis(out):
    """Return the point of the sphere's axis that lies so far from its middle."""
    return out * pole[0], 0, centre + out * pole[2]


first = TILT - 0.05 if mount == "half" else 0
count = 24
sweep_angle = -(math.pi + TILT + 0.1) if mount == "half" else 2 * math.pi
points = []
for k in range(count + (mount == "half")):
    a = first + sweep_angle * k / count
    points.append((mean * math.sin(a), 0, centre + mean * math.cos(a)))
meridian.add(sweep(points, radius=BAR, closed=mount == "ring"))
for sign in (-1, 1):
    at = on_axis(sign * (radius + mean - 0.0024) / 2)
    meridian.add(cylinder(0.003, mean - 0.0036 - radius), at=at, rpy=(0, TILT, 0))
globe.revolute(
    "tip", base, meridian, at=(0, 0, yoke + BAR), axis=(0, 1, 0), range=(-0.12, 0.12), friction=1.0
)
ball = globe.part("sphere", material="cardboard", mass=0.35)
ball.add(sphere(radius), at=(0, 0, centre), rgb=water)
patches = (
    (0.5, 0.5, 0.42),
    (1.2, 0.2, 0.3),
    (1.6, 1.0, 0.34),
    (2.4, 0.7, 0.5),
    (3.2, 0.5, 0.45),
    (3.9, -0.3, 0.38),
    (4.8, 0.3, 0.4),
    (5.4, -0.5, 0.36),
    (6.0, 0.9, 0.34),
    (0.1, -0.3, 0.36),
)
for lon, lat, size in patches:
    out = (math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat))
    # Of a sphere that stands a little out of the surface a disc of the angle `size` is seen.
    inset = 0.0012 * radius / (radius * (1 - math.cos(size)) + 0.0012)
    at = (inset * out[0], inset * out[1], centre + inset * out[2])
    ball.add(sphere(radius + 0.0012 - inset), at=at, rgb=land, role="visual")
globe.continuous("spin", meridian, ball, at=(0, 0, centre), axis=pole, friction=0.002)
dial = globe.part("hour_dial", material="metal")
at = on_axis(mean + BAR + 0.0006)
dial.add(cylinder(0.012, 0.003).moved((0, 0, 0.0015)), at=at, rpy=(0, TILT, 0))
dial.add(cylinder(0.006, KNOB).moved((0, 0, KNOB / 2)), at=at, rpy=(0, TILT, 0))
globe.continuous("dial_turn", meridian, dial, at=at, axis=pole)
