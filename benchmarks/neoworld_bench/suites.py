"""The table of benchmark suites: the options of each, and the function that runs it.

A suite is a module with a function from options to a JSON object, and a row of `SUITES`. Nothing
heavy is imported here, so that `--help` is quick; the function is imported when it is called.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tyro.conf import Positional

from neoworld_mjx.engines import ENGINES, EngineChoice, EngineName

MethodName = Literal[
    "ours",
    "open_loop",
    "gravity",
    "gradient",
    "no_simulation",
    "without_s_sem",
    "without_d_pen",
    "without_d_drift",
    "algorithm1",
    "random",
    "cma_es",
]
"""Methods that make a layout from a start: `dataset.scene_methods.METHODS`."""
NoiseName = Literal["exact", "layout", "parse", "programs", "all"]
"""Levels of noise of starts: `dataset.starts.NoiseLevel`."""


class Suite(NamedTuple):
    """A row of a table of suites."""

    options: type
    """Dataclass of its options; its docstring is the help of the command."""
    function: str
    """`package.module:function`, called with the options, and with the configuration if it takes
    one.
    """
    configured: bool = False
    """Whether it takes `--config` and `--set`."""

    def load(self) -> Callable[..., dict[str, Any]]:
        """Import the function."""
        module, name = self.function.split(":")
        return getattr(import_module(module), name)


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Time rollouts of noisy layouts, beside the naive loop and a bare scan of MJX."""

    objects: tuple[int, ...] = (3, 6, 10, 20, 40)
    """Numbers of objects on the table."""
    population: tuple[int, ...] = (1024,)
    """Numbers of candidates."""
    engine: tuple[EngineName, ...] = tuple(ENGINES)
    """Engines; one that cannot run here is a row that says why."""
    duration: float = 1.0
    """Simulated time [s], in steps of 4 ms."""
    budget: float = 60.0
    """Time that a row may take [s]; one that needs longer is skipped."""
    seed: int = 0
    """Seed of scenes and layouts."""
    chart: Path | None = None
    """SVG file to draw the growth of cost into."""


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Time the implementations of the penetration term."""

    objects: tuple[int, ...] = (3, 10, 40)
    """Numbers of objects on the table."""
    population: tuple[int, ...] = (256, 4096)
    """Numbers of candidates."""
    samples: int = 256
    """Surface samples of each object."""
    budget: float = 60.0
    """Time that the calls of a row may take [s]."""
    seed: int = 0
    """Seed of scenes and layouts."""
    pairs: int = 10_000
    """Random pairs of convex shapes whose sampled depth is compared with the exact one; 0 for
    none.
    """
    table: Path | None = None
    """JSON file of measured devices to enter this one into: what `pair_depth` chooses by."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Compare engines with MuJoCo on recompiled scenes: fields, bits, first steps, verdicts."""

    scene: tuple[str, ...] = ()
    """Scenes, of stack, cluttered, cabinet, container, leaning and mixed; none takes all six."""
    engine: tuple[EngineName, ...] = ("native",)
    """Engines whose verdicts are compared."""
    layouts: int = 64
    """Candidates of each scene."""
    seed: int = 0
    """Seed of the layouts."""


@dataclass(frozen=True, kw_only=True)
class Refine:
    """Refine scenes with known truth from noisy starts, beside Algorithm 1, random search and
    CMA-ES.
    """

    scene: tuple[str, ...] = ()
    """Names of scenes; none takes all twelve. crowd_20 and crowd_40 are there too."""
    real: bool = False
    """Refine the composed scenes of five photographs instead, which have no known truth."""
    seed: int = 0
    """Seed of the searches with `--real`."""
    seeds: int = 5
    """Starts of each scene."""
    baseline_seeds: int = 1
    """Starts of each scene for the baselines; Algorithm 1 takes half a minute each."""
    baseline: tuple[Literal["algorithm1", "random", "cma_es"], ...] = (
        "algorithm1",
        "random",
        "cma_es",
    )
    """Baselines to run; none with `--baseline` and nothing after it."""
    engine: EngineChoice = "native"
    """Engine that rolls candidates out."""


@dataclass(frozen=True, kw_only=True)
class Photos:
    """Take disturbed answers to forty scenes with known truth through fit, composition and search,
    and tell each step's errors and the objects that it made worse; needs no model.
    """

    scenes: tuple[int, ...] = ()
    """Numbers of scenes; none takes all: 0 to 19 are tuned on, 20 to 39 held out."""
    quick: bool = False
    """Take two scenes, and search little."""
    no_search: bool = False
    """Whether to refine; half a minute a scene on two cores."""
    semantic: bool = False
    """Tell instead how often S_sem scores the truth, seen without noise, higher than displacements
    of one object by 1 to 5 cm."""
    draws: int = 200
    """Displacements of each scene with `--semantic`."""
    seed: int = 0
    """Seed of the searches."""
    engine: EngineChoice = "native"
    """Engine that rolls candidates out."""


@dataclass(frozen=True, kw_only=True)
class SceneSet:
    """Run methods on the thirty scenes of the benchmark, each start with noise of its own, beside
    gravity alone, gradient refinement alone, the search without simulation and Algorithm 1.
    """

    scenes: tuple[str, ...] = ()
    """Names of scenes, or one number of scenes; none takes all."""
    starts: int = 2
    """Starts of each scene; those with odd numbers are the evaluation half."""
    method: tuple[MethodName, ...] = (
        "ours",
        "open_loop",
        "gravity",
        "gradient",
        "no_simulation",
        "algorithm1",
    )
    """Methods; random and cma_es make as many rollouts as ours, without_... leave a term of the
    reward out, as the paper's ablations do.
    """
    noise: NoiseName = "all"
    """Noise of the starts: none; positions, sizes, headings, camera and 2D boxes; these and wrong
    objects, carriers and openings; these and wrong shapes and joints; everything."""
    seed: int = 0
    """Seed of noise and searches."""
    workers: int = 0
    """Processes; 0 takes one for every two cores."""
    out: Path | None = None
    """Folder of results.parquet; rows that are there already are not run again."""
    submission: Path | None = None
    """Folder of another method's scenes to score in place of running methods: SCENE/scene.json,
    scene.xml or scene.usda (docs/benchmark-scenes.md).
    """


@dataclass(frozen=True, kw_only=True)
class ObjectSuite:
    """Hold joints and surfaces of made objects against those of PartNet-Mobility, which lies where
    you have it, or against truth files; beside them the paper's 245 joints.
    """

    made: Path | None = None
    """Folder of made objects by the names of the true ones: NAME.py, .urdf, .xml or .usda, or NAME/
    with program.py, spec.json or object.urdf.
    """
    partnet: Path | None = None
    """Folder of PartNet-Mobility: ID/mobility.urdf with its meshes."""
    truth: Path | None = None
    """Folder of truth files instead: NAME.json, with NAME.npz where surfaces are sampled."""
    object: tuple[str, ...] = ()
    """True objects; those that are not made are missed. None takes all that are made."""
    front: Literal["+x", "-x", "+y", "-y"] = "-x"
    """Direction in which objects of PartNet-Mobility face in their URDF."""
    out: Path | None = None
    """Folder of joints.parquet; rows replace those of the same objects."""


@dataclass(frozen=True, kw_only=True)
class Tasks:
    """Check the manipulation tasks on truth: reference plans succeed, nothing is true without a
    plan, and plans fail when the object concerned is elsewhere.
    """

    task: tuple[str, ...] = ()
    """Names of tasks; none takes all."""
    directions: int = 4
    """Directions in which the object concerned is displaced by half its size; 0 for none."""


@dataclass(frozen=True, kw_only=True)
class TaskSuccess:
    """Photograph each manipulation task, let methods make a layout of a disturbed answer, plan the
    task in it, and carry the plan out there and in the truth: task success.
    """

    task: tuple[str, ...] = ()
    """Names of tasks; none takes all 84."""
    starts: int = 2
    """Starts of each task; those with odd numbers are the evaluation half."""
    method: tuple[MethodName, ...] = ("ours", "open_loop", "gravity", "gradient", "no_simulation")
    """Methods, as in `bench run scenes`."""
    noise: Literal["exact", "layout", "parse"] = "parse"
    """Noise of the starts: none; positions, sizes, headings, camera and 2D boxes; these and wrong
    objects, carriers and openings. Programs have the true shapes.
    """
    seed: int = 0
    """Seed of noise and searches."""
    workers: int = 0
    """Processes; 0 takes one for every two cores."""
    out: Path | None = None
    """Folder of tasks.parquet; rows that are there already are not run again."""


@dataclass(frozen=True, kw_only=True)
class Plans:
    """Ask a model for plans of the manipulation tasks, and carry them out; what fails is told back,
    and may then refine the layout, as in Section 4.4 of the paper.
    """

    task: tuple[str, ...] = ()
    """Names of tasks; none takes all."""
    provider: str = "auto"
    """Who answers: auto, anthropic, openai, mailbox or replay."""
    tape: Path | None = None
    """Tape to replay."""
    mailbox: Path | None = None
    """Folder of the mailbox."""
    record: Path | None = None
    """Tape to record the answers on."""
    rounds: int = 2
    """Most revisions of a plan."""
    offset: float = 0.0
    """How far the named objects are moved in the scene that is told [m]."""
    feedback: bool = False
    """Whether a plan that fails refines the layout that it was made for."""
    seed: int = 0
    """Seed of the offsets and the refinement."""


@dataclass(frozen=True, kw_only=True)
class PictureSuite:
    """Hold pictures of made scenes against the photographs: SSIM, and LPIPS, CLIP, DINOv2 and Uni3D
    where their models are given.
    """

    folders: Positional[tuple[Path, ...]] = ()
    """Run folders, folders that `neoworld bench make` wrote, or submissions (with --data)."""
    data: Path | None = None
    """The data set whose photographs the scenes of a submission were made from."""
    clip: Path | None = None
    """CLIP: a folder with onnx/vision_model.onnx and preprocessor_config.json."""
    dino: Path | None = None
    """DINOv2: a folder with onnx/model.onnx and preprocessor_config.json."""
    lpips: Path | None = None
    """LPIPS: an ONNX file that takes two pictures."""
    uni3d: Path | None = None
    """Uni3D: a folder with points.onnx, image.onnx and preprocessor_config.json."""
    size: int = 512
    """Longer side of a scene's pictures, at most the photograph's [px]; an object's have 256."""
    no_objects: bool = False
    """Measure whole scenes alone."""
    out: Path | None = None
    """Folder to write the compared pictures into, the photograph left."""


@dataclass(frozen=True, kw_only=True)
class Judge:
    """Show made scenes to a model, which scores completeness, layout and function from 1 to 7."""

    folders: Positional[tuple[Path, ...]] = ()
    """Run folders, folders that `neoworld bench make` wrote, or submissions (with --data)."""
    data: Path | None = None
    """The data set whose photographs the scenes of a submission were made from."""
    repeats: int = 3
    """Judgements of each scene."""
    out: Path | None = None
    """Folder for answers.json with every answer as it came, and the pictures."""
    provider: str = "auto"
    """Who answers: auto, anthropic, openai, mailbox or replay."""
    tape: Path | None = None
    """Tape to replay."""
    mailbox: Path | None = None
    """Folder of the mailbox."""
    record: Path | None = None
    """Tape to record the answers on."""


@dataclass(frozen=True, kw_only=True)
class JointVideos:
    """Show a model each true joint's motion beside a made one's, and count those that it says are
    the same, as the paper decides hits; beside it, hits by geometry.
    """

    made: Path | None = None
    """Made object: a program, spec.json, URDF, MJCF or USD, or a folder of them by name."""
    truth: Path | None = None
    """True object, or a folder of them with the same names."""
    front: Literal["+x", "-x", "+y", "-y"] = "+x"
    """Direction in the true objects' frame in which their fronts face."""
    repeats: int = 1
    """Answers about each joint; more than half of them decide."""
    out: Path | None = None
    """Folder for answers.json with every answer as it came, and the pictures."""
    provider: str = "auto"
    """Who answers: auto, anthropic, openai, mailbox or replay."""
    tape: Path | None = None
    """Tape to replay."""
    mailbox: Path | None = None
    """Folder of the mailbox."""
    record: Path | None = None
    """Tape to record the answers on."""


SUITES = {
    "scenes": Suite(SceneSet, "neoworld_bench.run_suites:scenes_result", configured=True),
    "physics": Suite(Physics, "neoworld_bench.run_suites:physics_result"),
    "kernels": Suite(Kernels, "neoworld_bench.run_suites:kernels_result"),
    "agreement": Suite(Agreement, "neoworld_bench.run_suites:agreement_result"),
    "refine": Suite(Refine, "neoworld_bench.run_suites:refine_result", configured=True),
    "joints": Suite(ObjectSuite, "neoworld_bench.run_suites:joints_result", configured=True),
    "tasks": Suite(Tasks, "neoworld_bench.run_suites:tasks_result"),
    "task-success": Suite(
        TaskSuccess, "neoworld_bench.run_suites:task_success_result", configured=True
    ),
    "plans": Suite(Plans, "neoworld_bench.run_suites:plans_result", configured=True),
    "pictures": Suite(PictureSuite, "neoworld_bench.judge.judge_suites:pictures_result"),
    "judge": Suite(Judge, "neoworld_bench.judge.judge_suites:judge_result", configured=True),
    "joint-videos": Suite(
        JointVideos, "neoworld_bench.judge.judge_suites:joint_videos_result", configured=True
    ),
    "photos": Suite(Photos, "neoworld_bench.run_suites:photos_result", configured=True),
}
"""Suites that `neoworld bench run NAME` runs."""

DEVELOPER_SUITES = (
    *("battery", "composing", "costs", "decisions", "faults", "frames", "inputs", "programs"),
    *("readers", "round-trips", "scoring", "templates", "verify"),
)
"""Suites that `python -m benchmarks NAME` runs from a clone."""
