# Label: cushion
from neoworld_mjx.program.sdk import Object, rounded_box

depth = 0.12  # 0.05 to 0.3 m
width = 0.4  # 0.1 to 0.8 m
height = 0.4  # 0.1 to 0.8 m
colour = "teal"  # one of teal, ochre, rose, grey

TONE = {
    "teal": (0.15, 0.45, 0.47),
    "ochre": (0.8, 0.58, 0.22),
    "rose": (0.75, 0.42, 0.42),
    "grey": (0.55, 0.56, 0.58),
}
cushion = Object("cushion", label="cushion")
cloth = cushion.material("cloth", like="foam", friction=0.7, rgb=TONE[colour], pattern="weave")
size = (depth, width, height)
cushion.part("body", material=cloth).add(rounded_box(size, 0.3 * min(size)), by="bottom")
