# Label: open crate
from neoworld_mjx.program.sdk import Object, hollow_box

depth = 0.25  # 0.08 to 0.8 m
width = 0.32  # 0.08 to 0.8 m
height = 0.14  # 0.015 to 0.5 m
wall = 0.01  # 0.003 to 0.02 m
stuff = "pine"  # one of pine, oak, bamboo, cardboard, white, blue

TONE = {"white": (0.9, 0.9, 0.88), "blue": (0.25, 0.42, 0.6)}
crate = Object("crate", label="open crate")
like = "plastic" if stuff in TONE else stuff
skin = crate.material("skin", like=like, **({"rgb": TONE[stuff]} if stuff in TONE else {}))
crate.part("body", material=skin).add(hollow_box((depth, width, height), wall), by="bottom")
