# Label: open tray
from neoworld_mjx.program.sdk import Object, hollow_box

depth = 0.2  # 0.06 to 0.5 m
width = 0.3  # 0.06 to 0.5 m
height = 0.04  # 0.015 to 0.25 m
wall = 0.006  # 0.003 to 0.012 m
finish = "oak"  # one of oak, walnut, plastic, cardboard

obj = Object("tray", label="open tray")
obj.material("sheet", like=finish, density=700)
obj.part("tray", material="sheet").add(hollow_box((depth, width, height), wall), by="bottom")
