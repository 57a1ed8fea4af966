# Label: USB stick
# PartNet-Mobility: USB
from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, rounded_box, torus

depth = 0.066  # 0.055 to 0.08 m
width = 0.02  # 0.017 to 0.026 m
height = 0.011  # 0.009 to 0.014 m
kind = "swivel"  # one of swivel, slide, cap
ring = "yes"  # one of yes, no
colour = "blue"  # one of blue, red, black, green, white

LOOP = 0.012 if ring == "yes" else 0.0
PLUG = 0.013
usb = Object("usb_stick", label="USB stick")
tones = {
    "blue": (0.12, 0.28, 0.65),
    "red": (0.7, 0.1, 0.12),
    "black": (0.12, 0.12, 0.13),
    "green": (0.2, 0.55, 0.25),
    "white": (0.93, 0.93, 0.93),
}
usb.material("case", like="abs", rgb=tones[colour])
usb.material("metal", like="aluminium", rgb=(0.75, 0.76, 0.78))
front, rear = depth / 2, -depth / 2 + LOOP
long = front - rear
body = usb.part("body", material="case")
plug = (0.6 * width, 0.45 * height)
middle = height / 2
if kind == "swivel":
    # A bracket of sheet around the body turns about a rivet near its rear end.
    SHEET = 0.0012
    size = (long - PLUG, width, height - 2 * SHEET - 0.002)
    core = body.add(rounded_box(size, 0.001), at=(rear, 0, middle), by="back")
    body.add(box((PLUG, *plug)), at=(front - 0.0005, 0, middle), by="front", material="metal")
    cover = usb.part("cover", material="metal")
    for z, by in ((0, "bottom"), (height, "top")):
        cover.add(box((long - 0.006, width, SHEET)), at=(front, 0, z), by=f"front.{by}")
    cover.add(box((0.0015, width, height)), at=(front + 0.0014, 0, middle), by="back")
    front += 0.0029
    hub = (rear + 0.011, 0, middle)
    for z, by in ((SHEET, "bottom"), (height - SHEET, "top")):
        cover.add(cylinder(0.3 * width, 0.0007), at=(hub[0], 0, z), by=by)
    usb.continuous("swivel", body, cover, at=hub, axis="up")
elif kind == "slide":
    # The plug runs in the case and comes out as its slider on top is pushed.
    shell = hollow_box((long, width, height - 0.0025), 0.0015, open="+x")
    body.add(shell, at=(rear, 0, 0), by="back.bottom")
    plate = usb.part("plug", material="metal")
    plate.add(box((0.6 * long, *plug)), at=(front - 0.001, 0, (height - 0.0025) / 2), by="front")
    tongue = (0.6 * long, width - 0.0042, (height - 0.0055) * 0.9)
    plate.add(
        box((0.3 * long, *tongue[1:])),
        at=(front - 0.35 * long, 0, (height - 0.0025) / 2),
        by="front",
        material="case",
    )
    push = usb.prismatic("plug_slide", body, plate, axis="front", range=(0, PLUG))
    knob = usb.part("slider", material="abs")
    knob.add(
        box((0.014, 0.6 * width, 0.0017)),
        at=(rear + 0.012, 0, height),
        by="back.top",
        rgb=(0.2, 0.2, 0.21),
    )
    usb.prismatic("slider_push", body, knob, axis="front", range=(0, PLUG), mimic=push)
else:
    cap = usb.part("cap", material="case")
    reach = 0.36 * long
    body.add(
        rounded_box((long - reach - 0.0006, width, height), 0.002),
        at=(rear, 0, 0),
        by="back.bottom",
    )
    body.add(
        box((PLUG + 0.002, *plug)),
        at=(front - reach - 0.002, 0, middle),
        by="back",
        material="metal",
    )
    cap.add(
        hollow_box((reach, width, height), 0.002, open="-x"), at=(front, 0, 0), by="front.bottom"
    )
    usb.prismatic("cap_pull", body, cap, axis="front", range=(0, reach))
stripe = box((0.3 * long, 0.4 * width, 0.0004))
level = middle + (
    height / 2 - 0.0022
    if kind == "swivel"
    else height / 2
    if kind == "cap"
    else height / 2 - 0.0025
)
body.add(stripe, at=(rear + 0.35 * long, 0, level), rgb=(0.95, 0.95, 0.95), role="visual")
if ring == "yes":
    lug = box((0.0035, 0.003, 0.003))
    body.add(lug, at=(rear + 0.001, 0, middle), by="front", material="metal")
    loop = usb.part("ring", material="steel")
    hook = rear - 0.0031
    size = (hook + depth / 2) / 2
    loop.add(torus(size - 0.0008, 0.0008), at=(hook - size, 0, middle))
    at = (hook - 0.0008, 0, middle)
    usb.revolute("ring_turn", body, loop, at=at, axis=(0, 1, 0), range=(-0.3, 0.3), friction=0.0004)
