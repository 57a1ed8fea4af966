# Label: power socket
from neoworld_mjx.program.sdk import Object, box, panel

depth = 0.08  # 0.06 to 0.12 m
width = 0.1  # 0.08 to 0.2 m
height = 0.04  # 0.03 to 0.05 m
room = 0.004  # 0.003 to 0.006 m

obj = Object("socket", label="power socket")
case = obj.part("case", material="pvc")
case.add(box((depth, width, 0.01)), by="bottom")
slots = [(0, y, 0.008 + room, 0.005 + room) for y in (-0.013, 0.013)]
case.add(panel((depth, width), height - 0.01, holes=slots), at=(0, 0, 0.01), by="bottom")
