"""Results that other projects published on data of their own, as tables of docs/results.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from neoworld_bench.paper_figures import (
    PAPER_JOINTS,
    PAPER_SURFACES,
    PUBLISHED_LAYOUTS,
    PUBLISHED_STABILITY,
)
from neoworld_bench.tables.scene_table import PAPER as PAPER_SCENE_PHYSICS
from neoworld_bench.tasks.success_summary import OF_THE_PAPER
from neoworld_bench.tasks.success_summary import PAPER as PAPER_SUCCESS

NEOWORLD_PRO = "the paper of NeoWorld-Pro"


@dataclass(frozen=True)
class Published:
    """A table that another project published."""

    source: str
    data: str
    """Data on which the values were measured."""
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def _published(
    source: str,
    data: str,
    columns: Mapping[str, tuple[str, float, int]],
    values: Mapping[str, Mapping[str, float]],
) -> Published:
    """Return a table.

    Args:
        source: publication that contains the values.
        data: data on which the values were measured.
        columns: key in `values`, factor and number of digits, by the name of the column.
        values: values by method and key. The cell of a missing value is empty.
    """
    rows = [
        [
            f"{method}\\*",
            *(
                f"{factor * found[key]:.{digits}f}" if key in found else ""
                for key, factor, digits in columns.values()
            ),
        ]
        for method, found in values.items()
    ]
    return Published(source, data, ["method", *columns], rows)


_PHYSICS = {f"{name} [%]": (name, 1.0, 2) for name in ("S-Pen", "P-Pen", "S-Stab", "O-Stab")}
PUBLISHED = {
    "scenes": _published(
        NEOWORLD_PRO,
        "its own 30 scenes, from photographs",
        _PHYSICS,
        PAPER_SCENE_PHYSICS["full"],
    ),
    "tabletop": _published(
        NEOWORLD_PRO,
        "the 11 tabletop scenes among them",
        _PHYSICS,
        PAPER_SCENE_PHYSICS["tabletop"],
    ),
    "stability": _published(
        "rest3d.org, arXiv 2605.30338",
        "scenes of Replica and ScanNet++ and its own scenes, with its own definition of stable",
        {"stable, at least [%]": ("stable", 100.0, 0)},
        PUBLISHED_STABILITY,
    ),
    "tasks": _published(
        NEOWORLD_PRO,
        OF_THE_PAPER,
        {"success [%]": ("success", 100.0, 2)},
        {name: {"success": value} for name, value in PAPER_SUCCESS.items()},
    ),
    "layouts": _published(
        "SAM 3D, arXiv 2511.16624, Table 3",
        "Aria Digital Twin; objects with known poses, from one image and its points",
        {
            "3D IoU": ("box_iou", 1.0, 4),
            "ICP rotation [deg]": ("icp_rot_deg", 1.0, 2),
            "ADD-S": ("add_s", 1.0, 4),
            "ADD-S below 0.1 d [%]": ("recall", 100.0, 2),
        },
        PUBLISHED_LAYOUTS,
    ),
    "joints": _published(
        NEOWORLD_PRO,
        "245 joints of its own choice; a model that sees paired videos decides which are hits",
        {
            "true": ("total", 1.0, 0),
            "made": ("predicted", 1.0, 0),
            "hits": ("hits", 1.0, 0),
            "miss %": ("miss", 100.0, 2),
            "type %": ("type_error", 100.0, 2),
            "axis°": ("axis_deg", 1.0, 2),
            "pivot": ("pivot", 1.0, 2),
        },
        PAPER_JOINTS,
    ),
    "surfaces": _published(
        NEOWORLD_PRO,
        "objects of its own choice; it does not state how they were normalized",
        {
            "CD ×10": ("chamfer_x10", 1.0, 4),
            "F .01": ("f_01", 1.0, 2),
            "F .05": ("f_05", 1.0, 2),
        },
        PAPER_SURFACES,
    ),
}
"""Published tables, by name."""
