# Label: chest with a drawer
from neoworld_mjx.program.sdk import Object, box

chest = Object("chest")
body = chest.part("body", material="oak")
for z in (0.0, 0.47):
    body.add(box((0.3, 0.4, 0.03)), at=(0, 0, z), by="bottom")
for y in (-0.19, 0.19):
    body.add(box((0.3, 0.02, 0.44)), at=(0, y, 0.03), by="bottom")
body.add(box((0.3, 0.36, 0.02)), at=(0, 0, 0.25), by="bottom")
drawer = chest.part("drawer", material="walnut")
drawer.add(box((0.28, 0.34, 0.16)), at=(0.01, 0, 0.27), by="bottom", name="tray")
drawer.add(box((0.02, 0.1, 0.02)), at=(0.15, 0, 0.35), by="back", material="steel", name="handle")
chest.prismatic("slide", body, drawer, axis="front", range=(0.0, 0.2), damping=4.0, friction=0.5)
