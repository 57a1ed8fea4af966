"""Options of Steps 1 to 4 and of rendering."""

from typing import Literal

from ..options import Options, PaperDifference, option

Language = Literal["sdk", "blender"]
"""Languages in which object programs can be written."""


class ParseOptions(Options):
    """Options of Step 1, scene parsing."""

    critic_rounds: int = option(
        1, "Maximum number of revisions of the parse that the critic may request.", ge=0
    )
    max_side_px: int = option(
        1568,
        "Maximum length of the longer side of the image that the model sees.",
        unit="px",
        ge=64,
        le=8192,
    )


class JointSweepOptions(Options):
    """Option of the joint sweep in Steps 2 and 3.

    `program` and `verify` both have it. Set it to the same value; otherwise Step 3 may reject an
    object that Step 2 accepted.
    """

    max_depth_m: float = option(
        0.001, "Maximum penetration between two parts of an object.", unit="m", gt=0
    )


class ProgramOptions(JointSweepOptions):
    """Options of Step 2, procedural asset programming."""

    stages: Literal["one", "three"] = option(
        "one",
        "one: a single program. three: separate programs for geometry, articulation and export, "
        "each with its own debug and critic rounds, as in the paper.",
        difference=PaperDifference(
            "three",
            "One request gives the same quality as three.",
        ),
    )
    language: Language = option(
        "sdk",
        "sdk: programs call the SDK. blender: programs use Blender's Python API, which requires "
        "the package bpy in an environment of its own and runs in a confined process.",
        difference=PaperDifference(
            "blender",
            "The SDK needs no installation, and its shapes provide their convex decomposition.",
        ),
    )
    debug_rounds: int = option(
        1,
        "Maximum number of revisions of a program that fails. Each request contains the errors.",
        ge=0,
    )
    critic_rounds: int = option(
        1, "Maximum number of revisions of a program that the critic may request.", ge=0
    )
    geometry_critic: bool = option(True, "Let the critic rate shapes and colors.")
    articulation_critic: bool = option(
        True, "Let the critic rate the joints of articulated objects, in a separate call."
    )
    export_critic: bool = option(
        True, "With three stages, let the critic rate the object as imported from its URDF."
    )
    type_check: bool = option(True, "Type-check a program against the SDK before running it.")
    timeout_s: float = option(
        1.0,
        "Processor time limit for the program's own code, and separately for the shapes that it "
        "builds, rounded up to whole seconds.",
        unit="s",
        gt=0,
    )
    memory_mib: int = option(64, "Memory limit of the program.", unit="MiB", ge=8)
    blender_timeout_s: float = option(
        20.0,
        "CPU time limit for a program in Blender, and separately for the convex decomposition of "
        "its shapes.",
        unit="s",
        ge=1,
        le=3600,
    )
    blender_memory_mib: int = option(
        3072,
        "Maximum address space of the Blender process. Blender itself needs about 1300 MiB.",
        unit="MiB",
        ge=1536,
        le=65_536,
    )
    check_timeout_s: float = option(1.0, "Time limit for each check of the object.", unit="s", gt=0)


class VerifyOptions(JointSweepOptions):
    """Options of Step 3, object-level physics."""

    duration_s: float = option(2.0, "Simulated time of each scenario.", unit="s", ge=0.5, le=100)
    impulse_ns_per_kg: float = option(
        0.3,
        "Impulse of the force perturbation per unit mass, which equals the change of velocity "
        "in m/s.",
        unit="N s/kg",
        ge=0,
    )
    max_drift_m: float = option(0.01, "Maximum displacement in a scenario.", unit="m", gt=0)
    max_tilt_deg: float = option(5.0, "Maximum rotation in a scenario.", unit="deg", gt=0)
    rounds: int = option(
        6, "Maximum number of repair attempts per object; 0 leaves objects unchanged.", ge=0
    )
    direct_repairs: bool = option(
        True,
        "Repair an object from the measurements of its failed checks before querying a model.",
        difference=PaperDifference(
            False,
            "A measurement that identifies the fault saves a model call.",
        ),
    )
    critic: Literal["auto", "always", "never"] = option(
        "auto",
        "auto: if a model is available, show the critic key frames of failed and borderline "
        "checks, and try the edits that the reasoner suggests. always: also show the critic every "
        "object in the two standard scenarios; a tape must contain the critic's responses. never: "
        "query no model.",
        difference=PaperDifference(
            "always", "Calls about objects that clearly pass find no faults."
        ),
    )


class AlignOptions(Options):
    """Options of the alignment of the composed scene with the pixels of the photograph."""

    enabled: bool = option(
        True,
        "Align the camera and the composed layout with the contours of the objects in the "
        "photograph.",
        difference=PaperDifference(
            False,
            "Contours in the photograph locate objects and the camera better than a model's "
            "response.",
        ),
    )
    camera: bool = option(True, "Also estimate the camera's pitch, roll, field of view and height.")
    contours: bool = option(
        True,
        "Use the contours of objects in the photograph. If false, use only the parsed 2D boxes.",
    )
    edges: bool = option(
        True,
        "Also use the vertical edges in the photograph as evidence about the camera. Requires "
        "`camera` and `contours`.",
    )
    contacts: bool = option(True, "Keep objects from overlapping while they are aligned.")
    final: bool = option(
        True,
        "After the refinement, align the objects that settling or the search moved in the image "
        "once more, at the tilts at which they rest. The result is used if it passes the final "
        "check. Requires `contours`.",
    )

    @property
    def aligns_again(self) -> bool:
        """True if objects that the refinement moved are aligned again."""
        return self.enabled and self.contours and self.final


class ComposeOptions(Options):
    """Options of Step 4, scene composition."""

    refit: bool = option(
        True,
        "Before composition, move the camera and the reconstructed objects to their 2D boxes.",
        difference=PaperDifference(
            False,
            "Models estimate distances less accurately than 2D boxes.",
        ),
    )
    settle: bool = option(
        True,
        "Simulate objects that lie tilted on a dish or slope, or lean in a container, until they "
        "are at rest. Place contents and lids inside their container, rather than on its rim.",
        difference=PaperDifference(
            False,
            "The search does not change tilts, and few objects are at rest at their parsed tilt.",
        ),
    )
    hold_joints: bool = option(
        True,
        "Increase the dry friction of joints that gravity would move from their parsed positions.",
        difference=PaperDifference(
            False,
            "Friction holds a joint that is half open in the photograph, and the search does not "
            "move joints.",
        ),
    )
    align: AlignOptions = AlignOptions()
    looks: bool = option(
        True,
        "Make rendered images of the scene look like the photograph: use the photograph as a "
        "texture of large flat faces, one exposure and white balance for all images, and a "
        "backdrop of the measured color. Shapes, masses and poses do not change.",
        difference=PaperDifference(
            False,
            "Scores by a model and the report compare rendered images with the photograph.",
        ),
    )


class RenderOptions(Options):
    """Options of ray-cast images."""

    width: int = option(480, "Width of rendered images.", unit="px", ge=16, le=8192)
    supersample: int = option(
        2, "Number of rays along each axis of a pixel, for pixels at edges.", ge=1, le=4
    )
