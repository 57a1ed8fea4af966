"""The suites that look: `pictures`, `judge` and `joint-videos`, from options to a JSON object."""

from typing import Any

from neoworld_mjx.config import Config
from neoworld_mjx.mllm import Panel, open_panel

from .. import suites
from ..rows import collect, log, plain


def pictures_result(o: suites.PictureSuite) -> dict[str, Any]:
    """Measure pictures."""
    from ..measures.picture_similarity import PictureModels
    from .picture_rows import picture_figures, picture_rows

    models = PictureModels.load(clip=o.clip, dino=o.dino, lpips=o.lpips, uni3d=o.uni3d)
    rows = []
    for row in picture_rows(
        o.folders, models, side=o.size, objects=not o.no_objects, data=o.data, out=o.out
    ):
        rows.append(row)
        log.info(row.line())
    return {**picture_figures(rows), "models": models.described(), "rows": plain(rows)}


def judge_result(o: suites.Judge, config: Config) -> dict[str, Any]:
    """Have scenes judged."""
    from .made_scenes import made_scenes
    from .scene_judge import rating_figures, rating_rows

    scenes = made_scenes(o.folders, o.data)
    with _panel(o, config) as models:
        rows = collect(rating_rows(models, scenes, repeats=o.repeats, out=o.out))
    return {**rating_figures(rows), "rows": plain(rows)}


def joint_videos_result(o: suites.JointVideos, config: Config) -> dict[str, Any]:
    """Have the motions of joints compared."""
    from .joint_films import object_pairs
    from .joint_hits import joint_hit_figures, joint_hit_rows

    pairs = object_pairs(o.made, o.truth, config.program, front=o.front)
    with _panel(o, config) as models:
        rows = collect(joint_hit_rows(models, pairs, repeats=o.repeats, out=o.out))
    return {**joint_hit_figures(rows, pairs), "rows": plain(rows)}


def _panel(o: suites.Judge | suites.JointVideos, config: Config) -> Panel:
    tapes = () if o.tape is None else (o.tape,)
    return open_panel(config.mllm, o.provider, tapes=tapes, mailbox=o.mailbox, record=o.record)
