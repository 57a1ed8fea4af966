"""Insertion tasks: an object goes through an opening and is supported there."""

import math

from neoworld_mjx.spec import Quat
from neoworld_mjx.templates.template import Value

from .carrying_tasks import carry, inserted
from .placing_tasks import LYING
from .reference import Grasp, grasp_box
from .task import Prepared
from .task_scenes import put, scene_of

RACK_FLOOR = 0.012
TUBE_AT_REST: Quat = (0.7086103, 0.0462457, 0.7025625, 0.0462457)
"""Rotation with which the test tube lies on its rim and foot, on one of its 24 flat sides."""


def tube_into_rack(
    column: int,
    row: int,
    *,
    start: str,
    across: float = 0.02,
    finish: str = "pine",
    yaw: float = 0.0,
    columns: int = 5,
    rows: int = 2,
) -> Prepared:
    """Put a test tube into a hole of a rack, from a stand, from the table or from another hole."""
    hole = across / 2 + 0.002
    width = 0.016 + columns * max(0.04, 2.4 * hole)
    depth = 0.05 * rows
    rack: dict[str, Value] = {
        "columns": columns,
        "rows": rows,
        "hole": hole,
        "width": width,
        "depth": depth,
        "finish": finish,
    }
    tube: dict[str, Value] = {"depth": across, "width": across}
    others = [put("tube_rack", (0.12, 0.0), yaw=yaw, values=rack)]
    pitch = (width - 0.016) / columns
    spot = lambda i, j: ((j + 0.5) * depth / rows - depth / 2, (i - (columns - 1) / 2) * pitch)
    if start == "stand":
        stand = {"columns": 1, "rows": 1, "width": 0.06, "depth": 0.05, "hole": hole}
        others.append(put("tube_rack", (-0.15, -0.1), name="stand", values=stand))
        others.append(put("test_tube", on="stand", z=RACK_FLOOR, values=tube))
        grasp = Grasp((0.0, 0.0, 0.105), across)
    elif start == "lying":
        others.append(put("test_tube", (-0.25, -0.1), tilt=TUBE_AT_REST, values=tube))
        # From above as it lies; the fingers point at the tube's side once it stands.
        grasp = Grasp((0.0, 0.0, 0.1), across - 0.0024, approach=(1.0, 0.0, 0.0))
    else:
        x, y = spot(0, 0)
        others.append(put("test_tube", (x, y), on="tube_rack", z=RACK_FLOOR, values=tube))
        grasp = Grasp((0.0, 0.0, 0.105), across, closing=(1.0, 0.0, 0.0))
    x, y = spot(columns - 1, rows - 1) if start == "stand" and row else spot(1, 0)
    others.append(
        put("test_tube", (x, y), name="neighbour", on="tube_rack", z=RACK_FLOOR, values=tube)
    )
    scene = scene_of("tube_into_rack", *others)
    x, y = spot(column, row)
    goal = inserted("test_tube", "tube_rack", (x, y, 0.085), hole, 0.06)
    return carry(
        scene, goal, "test_tube", grasp, "tube_rack", (x, y, 0.014), hover=0.09, clear=0.16
    )


def peg_into_board(
    *,
    form: str,
    across: float,
    room: float,
    yaw: float = 0.0,
    hole: int = 0,
    holes: int = 1,
    lying: bool = False,
    height: float = 0.1,
    colour: str = "yellow",
) -> Prepared:
    """Put a peg into a hole of a board."""
    across_peg: dict[str, Value] = {
        "form": "faceted" if lying else form,  # A round one would roll.
        "depth": across,
        "width": across,
        "height": height,
        "colour": colour,
    }
    board: dict[str, Value] = {
        "form": form,
        "hole": across + room,
        "columns": holes,
        "width": 0.08 * holes,
        "depth": 0.08,
    }
    tilt = LYING if lying else (1.0, 0.0, 0.0, 0.0)
    scene = scene_of(
        f"{form}_peg",
        put("hole_board", (0.15, 0.05), yaw=yaw, values=board),
        put("peg", (-0.15, -0.1), yaw=0.3 if lying else 0.2, tilt=tilt, values=across_peg),
        put("toy_block", (0.0, 0.25), values={"form": "cylinder", "colour": "green"}),
    )
    at = (0.0, (hole - (holes - 1) / 2) * 0.08)
    goal = inserted("peg", "hole_board", (*at, 0.05), (across + room) / 2, 0.025)
    grasp = grasp_box(scene, "peg")
    if lying:
        grasp = Grasp((0.0, 0.0, height - 0.02), across, approach=(1.0, 0.0, 0.0))
    return carry(scene, goal, "peg", grasp, "hole_board", (*at, 0.008), hover=0.06)


def pencil_into_holder() -> Prepared:
    """Put a pencil into the middle hole of a holder."""
    scene = scene_of(
        "pencil_into_holder",
        put("hole_board", (0.15, 0.0), values={"hole": 0.016, "columns": 3, "width": 0.15}),
        put("hole_board", (-0.15, 0.0), name="block", values={"hole": 0.0112}),
        put("pencil", on="block", z=0.006, values={"colour": "red"}),
    )
    goal = inserted("pencil", "hole_board", (0.0, 0.0, 0.05), 0.008, 0.03)
    grasp = Grasp((0.0, 0.0, 0.15), 0.01, slack=0.002)
    return carry(scene, goal, "pencil", grasp, "hole_board", (0, 0, 0.008), hover=0.08, clear=0.12)


def plug_into_socket(yaw: float, room: float) -> Prepared:
    """Put a plug with two pins into a socket."""
    scene = scene_of(
        "plug_into_socket",
        put("socket", (0.15, 0.05), yaw=yaw, fixed=True, values={"room": room}),
        put("hole_board", (-0.15, 0.0), name="rest", values={"form": "slot", "hole": 0.036}),
        put("plug", on="rest", z=0.03, yaw=0.0),
    )
    goal = inserted("plug", "socket", (0.0, 0.0, 0.04), 0.004, 0.015, heading=math.radians(10))
    grasp = grasp_box(scene, "plug", depth=0.015)
    return carry(scene, goal, "plug", grasp, "socket", (0.0, 0.0, 0.021), hover=0.05, drop=0.001)


def domino_into_slot(yaw: float, room: float) -> Prepared:
    """Put a standing domino into a slot."""
    board: dict[str, Value] = {"form": "slot", "hole": 0.04 + room, "slot": 0.012 + room}
    scene = scene_of(
        "domino_into_slot",
        put("hole_board", (0.15, 0.1), yaw=yaw, values=board),
        put("domino", (-0.2, -0.1), yaw=0.2),
    )
    goal = inserted("domino", "hole_board", (0, 0, 0.05), 0.01, 0.03)
    grasp = grasp_box(scene, "domino")
    return carry(scene, goal, "domino", grasp, "hole_board", (0, 0, 0.008), hover=0.07)
