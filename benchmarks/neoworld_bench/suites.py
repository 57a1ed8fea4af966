"""Benchmark suites: the options of each, and the function that runs it.

A suite is a function from options to a JSON object, and a row of `SUITES`. The function is imported
when it is called, so that `--help` stays fast.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tyro.conf import Positional

from neoworld_mjx.engines import ENGINES, EngineChoice, EngineName
from neoworld_mjx.machines import Machines

NoiseName = Literal["exact", "layout", "parse", "programs", "all"]
"""Noise levels of `noise.initial_scenes.NoiseLevel`."""
KnownView = Literal["photo", "camera", "depth"]
"""Evidence about a real view: the photograph, alone, with its camera, and with its depth."""
FrontName = Literal["+x", "-x", "+y", "-y"]


class Suite(NamedTuple):
    """A row of `SUITES`."""

    options: type
    """Dataclass of its options; its docstring is the help text of the command."""
    function: str
    """`package.module:function`, called with the options, and with the configuration if
    `configured`.
    """
    configured: bool = False
    """True if the suite takes `--config` and `--set`."""

    def load(self) -> Callable[..., dict[str, Any]]:
        """Import the function."""
        module, name = self.function.split(":")
        return getattr(import_module(module), name)


@dataclass(frozen=True, kw_only=True)
class NoisyRuns(Machines):
    """Options of suites that run methods from noisy initial scenes."""

    evidence: tuple[str, ...] = ("none",)
    """Evidence in addition to the photograph: kinds joined by "+", such as fov+depth; the
    methods run with each. fov, exif: field of view, calibrated or with an error of 3 %; pose:
    pitch, roll and height of the camera; depth: of a sensor; affine, disparity: depth of a network,
    up to scale and shift; masks; second, stereo: a second photograph, with unknown or known pose.
    """

    starts: int = 2
    """Initial scenes of each scene or task; those with odd numbers are the evaluation half."""
    seed: int = 0
    """Seed of the noise and the searches."""
    workers: int = 0
    """Processes; 0 starts one for every two cores."""


@dataclass(frozen=True, kw_only=True)
class ModelRequests:
    """Options of suites that send requests to a model."""

    provider: str = "auto"
    """Source of the responses: auto, anthropic, openai, mailbox or replay."""
    tape: Path | None = None
    """Tape to replay."""
    mailbox: Path | None = None
    """Folder of the mailbox."""
    record: Path | None = None
    """Tape to record the responses on."""


@dataclass(frozen=True, kw_only=True)
class Examples:
    """Reconstruct the bundled examples from their tapes."""

    example: tuple[str, ...] = ()
    """Names that `neoworld examples` lists; all by default."""


@dataclass(frozen=True, kw_only=True)
class Photos:
    """Run composition, alignment and search on noisy responses to forty rendered scenes, and report
    each step's errors and the objects that it made worse; needs no model.
    """

    scenes: tuple[int, ...] = ()
    """Numbers of scenes, all by default: 0 to 19 are tuned on, 20 to 39 held out."""
    no_search: bool = False
    """Skip the search, which takes half a minute per scene on two cores."""
    seed: int = 0
    """Seed of the searches."""
    engine: EngineChoice = "native"
    """Engine that rolls candidates out."""


@dataclass(frozen=True, kw_only=True)
class SceneSet(NoisyRuns):
    """Run methods on the thirty scenes of the benchmark, each from its own noisy initial scenes."""

    scenes: tuple[str, ...] = ()
    """Names of scenes, a single number of scenes, or `arrangements`; the thirty by default."""
    method: tuple[str, ...] = ("ours", "open_loop", "gravity", "guided", "no_simulation")
    """Methods: ours; without a search open_loop, gravity, guided and aligned; other searches
    algorithm1, algorithm1_aligned and random; ablations no_simulation, without_s_sem,
    without_d_pen, without_d_drift, without_photo, without_contours, without_edges and
    without_final."""
    noise: NoiseName = "all"
    """Noise of the initial scenes. exact: none; layout: positions, sizes, headings, camera and 2D
    boxes; parse: also wrong objects, parents and openings; programs: layout, and wrong shapes and
    joints; all: parse and programs."""
    submission: Path | None = None
    """Folder of another method's scenes to score instead of running methods: SCENE/scene.json,
    scene.xml, scene.glb, or meshes with a poses.json (docs/benchmark.md)."""


@dataclass(frozen=True, kw_only=True)
class Tasks(NoisyRuns):
    """Photograph each of the 84 manipulation tasks, let methods reconstruct it from a noisy
    response, plan the task there, and execute the plan there and in the ground truth.
    """

    task: tuple[str, ...] = ()
    """Names of tasks; all by default."""
    method: tuple[str, ...] = ("truth", "ours", "open_loop", "gravity", "guided", "no_simulation")
    """Methods, as in `bench run scenes`; truth executes the reference plans in the ground truth."""
    noise: Literal["exact", "layout", "parse"] = "parse"
    """Noise of the initial scenes, as in `bench run scenes`. Programs have the ground-truth shapes.
    """
    samples: int = 0
    """Draws about each result, as of `neoworld sample`, in which plans are executed: predicted
    success, and the plan that succeeds in the most draws."""


@dataclass(frozen=True, kw_only=True)
class Plans(ModelRequests):
    """Request plans of the manipulation tasks from a model, and execute them in the scene that it
    sees and in the ground truth; a plan that fails refines the layout, as in Section 4.4 of the
    paper.
    """

    task: tuple[str, ...] = ()
    """Names of tasks; all by default."""
    method: tuple[str, ...] = ("truth", "ours", "open_loop")
    """Methods that reconstruct the scene that the model sees, as in `bench run tasks`."""
    evidence: str = "none"
    """Evidence in addition to the photograph, as one set of `bench run tasks`."""
    starts: int = 1
    """Initial scenes of each task and method."""
    noise: Literal["exact", "layout", "parse"] = "parse"
    """Noise of the initial scenes."""
    seed: int = 0
    """Seed of the noise, the searches and the refinement."""


@dataclass(frozen=True, kw_only=True)
class Policies(NoisyRuns):
    """Train policies of a flying gripper or a robot in reconstructions of manipulation tasks, run
    them in the ground truth, and compare them with the open-loop plan of the same reconstruction.
    """

    task: tuple[str, ...] = ()
    """Names of tasks. By default --each of opening, closing, pushing and placement are drawn."""
    each: int = 2
    """Tasks of each kind: the first in an order shuffled by seed 0."""
    robot: str | None = None
    """Robot instead of the flying gripper, as in `neoworld train`: panda, so101, ur5e or a file."""
    trained_in: tuple[Literal["plan", "scene", "mean", "truth"], ...] = (
        *("plan", "scene", "truth", "mean"),
    )
    """Scenes in which policies are trained, each on all tasks before the next. scene: in draws of
    the reconstruction; mean: in the reconstruction alone, without randomization; truth: in the
    ground truth with draws of its physics. plan is the open-loop plan instead."""
    method: Literal["ours", "no_simulation", "without_s_sem", "open_loop"] = "ours"
    """Method that makes the reconstructions, as in `bench run tasks`."""
    noise: Literal["exact", "layout", "parse"] = "parse"
    """Noise of the initial scenes, as in `bench run tasks`."""
    starts: int = 1
    """Initial scenes of each task."""
    workers: int = 1
    """Processes; each trains one task after another on all cores."""
    steps: int = 4_000_000
    """Control steps of each training."""
    minutes: float | None = None
    """Largest duration of each training, without compiling."""
    worlds: int | None = None
    """Worlds of a training."""
    draws: int = 64
    """Draws of a scene in training."""
    samples: int = 256
    """Draws in which policies are run; from seeds other than those of training."""
    engine: Literal["native", "warp"] = "native"
    """Engine of training; policies are run by C MuJoCo."""
    keep: Path | None = None
    """Folder in which the policies are kept; by default, they are deleted after the run."""


@dataclass(frozen=True, kw_only=True)
class Rescues:
    """Rescue generated scenes of meshes whose objects have wrong sizes (up to 10 %), are 2 cm too
    low and tilted by 5 degrees, and compare the results with the undisturbed scenes.
    """

    scenes: int = 60
    """Number of scenes."""
    photo: bool = False
    """Give each rescue a rendered photograph of the undisturbed scene, with its exact camera."""


@dataclass(frozen=True, kw_only=True)
class Engines:
    """Time rollouts of noisy layouts by engine and population, and compare verdicts with C MuJoCo
    on recompiled scenes.
    """

    scenes: tuple[str, ...] = ("crowded:3", "crowded:10", "crowded:40")
    """Scenes, named as in sweeps; candidates are noisy layouts about them."""
    engine: tuple[EngineName, ...] = tuple(ENGINES)
    """Engines; the row of an engine that cannot run here gives the reason."""
    population: tuple[int, ...] = (1024,)
    """Numbers of candidates."""
    early_stop: bool = False
    """Stop candidates that have moved too far, as the search does."""
    duration: float = 1.0
    """Simulated time [s], in steps of 4 ms."""
    budget: float = 60.0
    """Time limit of a row [s]; a row that needs longer is skipped."""
    seed: int = 0
    """Seed of the layouts."""


@dataclass(frozen=True, kw_only=True)
class RealPoses:
    """Score reconstructions of real photographs against a sensor's depth and true poses, in the
    layout of your copy of a data set. Nothing is downloaded; docs/benchmark.md has the layouts.
    """

    data: Positional[Path | None] = None
    """Folder of the data: depth images NAME-depth.png, or a data set in the BOP format (YCB-V,
    T-LESS, HOPE, HomebrewedDB)."""
    runs: Path | None = None
    """Folder of run folders named after the views. A row is written for each of their scenes:
    composed, aligned and refined."""
    place_with: tuple[KnownView, ...] = ()
    """Also place the objects of each run anew, and score them: with the photograph alone, with the
    camera of DATA, or with camera and depth of DATA."""


@dataclass(frozen=True, kw_only=True)
class ObjectSuite:
    """Compare joints and surfaces of reconstructed objects with those of ground-truth objects,
    alongside the paper's 245 joints.
    """

    made: Path | None = None
    """Folder of objects named like the ground-truth objects: NAME.py, .urdf or .xml, or NAME/ with
    program.py, spec.json or object.urdf.
    """
    truth: Path | None = None
    """Folder of ground-truth objects in the same layout, or of PartNet-Mobility
    (ID/mobility.urdf)."""
    object: tuple[str, ...] = ()
    """Ground-truth objects; those without a reconstruction count as missed. By default all that
    have one."""
    front: FrontName = "-x"
    """Direction in which the ground-truth objects face; -x in PartNet-Mobility."""


@dataclass(frozen=True, kw_only=True)
class All:
    """Run the suites of docs/results.md, each into a file, and compare the figures with earlier
    ones. Tables that this commit has already made are not made again.
    """

    out: Path = Path("results")
    """Folder of the files TABLE.json."""
    tables: tuple[str, ...] = ()
    """Names of tables (`neoworld_bench.all_tables`); all that need no GPU by default."""
    against: Path | None = None
    """Folder of earlier files. Lists the figures whose intervals do not overlap."""
    workers: int = 0
    """Processes; 0 starts one for every two cores."""


SUITES = {
    name: Suite(options, f"neoworld_bench.run_suites:run_{name.replace('-', '_')}", configured)
    for name, options, configured in (
        ("scenes", SceneSet, True),
        ("tasks", Tasks, True),
        ("plans", Plans, True),
        ("policies", Policies, True),
        ("rescue", Rescues, False),
        ("engines", Engines, False),
        ("examples", Examples, True),
        ("photos", Photos, True),
        ("real-poses", RealPoses, True),
        ("joints", ObjectSuite, True),
        ("all", All, False),
    )
}
"""Suites that `neoworld bench run NAME` runs."""
