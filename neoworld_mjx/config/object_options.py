"""Options of the steps that make objects and scenes: parse, program, verify, compose, render."""

from typing import Literal

from ..options import Options, PaperDifference, option

Language = Literal["sdk", "blender"]
"""Languages of object programs."""


class ParseOptions(Options):
    """Step 1, scene parsing."""

    critic_rounds: int = option(1, "Times that the critic may send the parse back.", ge=0)
    max_side_px: int = option(
        1568, "Longer side of the picture that the model is shown.", unit="px", ge=64, le=8192
    )
    min_side_px: int = option(
        512,
        "Least longer side of that picture: smaller photos are shown enlarged by a whole factor.",
        unit="px",
        ge=16,
        le=1024,
    )
    fit: bool = option(
        True,
        "Fit camera and 3D boxes to the 2D boxes by least squares, object by object, as far as the "
        "picture contradicts the answer.",
        difference=PaperDifference(
            False,
            "A model judges sizes and distances less exactly than it draws boxes around things.",
            "layout error 12.3 and 20.3 mm, size 2.18 and 2.34 % (n = 20 rendered scenes held out)",
        ),
    )


class JointSweepOptions(Options):
    """The joint sweep of Steps 2 and 3.

    `program` and `verify` inherit these options and their defaults. Give both sections the same
    values: otherwise Step 3 may refuse what Step 2 passed.
    """

    max_depth_m: float = option(
        0.001, "Largest penetration between two parts of an object.", unit="m", gt=0
    )
    touch_gap_m: float = option(
        0.002,
        "Largest gap between a part and the part that it is attached to. Step 3 passes twice as "
        "much, or 1 % of the object's size where that is more.",
        unit="m",
        ge=0,
    )
    sweep_steps: int = option(13, "Positions tried over each joint's range.", ge=3, le=1000)
    sweep_combinations: int = option(
        16, "States tried with all joints moved at once.", ge=0, le=10_000
    )


class ProgramOptions(JointSweepOptions):
    """Step 2, procedural asset programming."""

    stages: Literal["one", "three"] = option(
        "one",
        "one: a whole program at once. three: a program for geometry, one for articulation on the "
        "accepted geometry, one for export, each with debug and critic rounds of its own.",
        difference=PaperDifference(
            "three",
            "One request in place of three finds as much.",
            "27 and 27 of 29 joints hit, 42 and 79 calls (n = 12 objects)",
        ),
    )
    language: Language = option(
        "sdk",
        "sdk: programs call the SDK. blender: they are written in Blender's Python, which needs "
        "`neoworld doctor --install blender` and runs confined in a process of its own.",
        difference=PaperDifference(
            "blender",
            "The SDK needs nothing installed, and its shapes know their own convex pieces.",
            "the same 7 joints; 0.32 to 0.74 and 8.9 to 11.4 s a build on a loaded machine "
            "(n = 3 objects)",
        ),
    )
    debug_rounds: int = option(
        1, "Times that a program that fails is sent back with its errors.", ge=0
    )
    critic_rounds: int = option(1, "Times that the critic may send a program back.", ge=0)
    geometry_critic: bool = option(True, "Have a critic judge shapes and colours.")
    articulation_critic: bool = option(
        True, "Have a critic judge joints, by a call of its own, where any joint moves."
    )
    export_critic: bool = option(
        True, "With three stages, have a critic judge the object that its URDF gives back."
    )
    sandbox: Literal["monty", "cpython"] = option(
        "monty",
        "monty: in a sandbox. cpython: in this very process, without any isolation, for your own "
        "programs only.",
    )
    type_check: bool = option(True, "Check a program's types against the SDK before it runs.")
    timeout_s: float = option(
        1.0,
        "Time for the program's own code, and as much again for the shapes that it builds.",
        unit="s",
        gt=0,
    )
    memory_mib: int = option(64, "Memory of the program.", unit="MiB", ge=8)
    max_recursion: int = option(200, "Depth of the program's calls.", ge=10)
    max_calls: int = option(5000, "Calls of the SDK.", ge=10)
    max_output_bytes: int = option(20_000, "Length of what the program prints.", unit="B", ge=0)
    max_text_bytes: int = option(200_000, "Length of the program's text.", unit="B", ge=100)
    max_parts: int = option(300, "Parts of an object.", ge=1)
    max_geoms: int = option(3000, "Geoms of an object.", ge=1)
    max_pieces: int = option(4000, "Convex collision geoms of an object.", ge=1)
    blender_timeout_s: float = option(
        20.0,
        "Processor time of a program in Blender, and as much again for splitting its shapes into "
        "convex pieces.",
        unit="s",
        ge=1,
        le=3600,
    )
    blender_memory_mib: int = option(
        3072,
        "Address space of the process; Blender itself takes some 1300.",
        unit="MiB",
        ge=1536,
        le=65_536,
    )
    workers: int = option(2, "Sandbox processes kept for programs that run at once.", ge=1)
    check_timeout_s: float = option(1.0, "Time for each check of the object.", unit="s", gt=0)


class VerifyOptions(JointSweepOptions):
    """Step 3, object-level physics."""

    duration_s: float = option(2.0, "Simulated time of each scenario.", unit="s", gt=0, le=100)
    timestep_s: float = option(0.002, "Time step of the simulation.", unit="s", ge=1e-4, le=0.1)
    drop_height_m: float = option(0.005, "Height of the free fall.", unit="m", ge=0)
    impulse_ns_per_kg: float = option(
        0.3,
        "Impulse of the force perturbation per mass, that is the change of speed in m/s.",
        unit="N s/kg",
        ge=0,
    )
    push_duration_s: float = option(
        0.1, "Time over which the impulse is spread.", unit="s", gt=0, le=100
    )
    max_drift_m: float = option(0.01, "Largest displacement in a scenario.", unit="m", gt=0)
    max_tilt_deg: float = option(5.0, "Largest rotation in a scenario.", unit="deg", gt=0)
    max_rest_speed: float = option(
        0.01, "Largest speed at the end of the free fall.", unit="m/s", gt=0
    )
    max_energy_gain: float = option(
        0.02,
        "Largest rise of mechanical energy without an applied force, over the object's weight "
        "times its extent.",
        gt=0,
    )
    max_overshoot: float = option(
        0.05, "Largest travel beyond a joint limit, over the joint's range.", gt=0
    )
    joint_push_s: float = option(
        0.5, "Time in which a free joint is pushed across its range.", unit="s", gt=0, le=100
    )
    min_mobility: float = option(
        0.9,
        "Smallest share of its range that a joint covers when it is driven both ways.",
        gt=0,
        le=1,
    )
    hand_force_n: float = option(
        100.0,
        "Largest force that drives a joint, at its far end; for heavy parts half their weight is "
        "added.",
        unit="N",
        gt=0,
    )
    high_drop_m: float = option(0.02, "Height of the second, higher fall.", unit="m", ge=0)
    drop_tilt_deg: float = option(
        3.0, "Tilt of the falls that start tilted.", unit="deg", ge=0, lt=45
    )
    min_loss: float = option(
        0.05,
        "Smallest share of its speed that a joint left to itself loses in half a second.",
        ge=0,
        lt=1,
    )
    min_slide_deg: float = option(
        5.0, "Slope on which an object must still rest.", unit="deg", ge=0
    )
    max_slide_deg: float = option(
        60.0, "Slope on which an object must slide.", unit="deg", gt=0, le=65
    )
    max_pivot_off: float = option(
        0.05,
        "Largest distance between a hinge's axis and the parts that it joins, over the child's "
        "diagonal.",
        ge=0,
    )
    rounds: int = option(
        6, "Repairs of an object that may be tried; 0 leaves objects unchanged.", ge=0
    )
    direct_repairs: bool = option(
        True,
        "Repair by what a failed check measures, before a model is asked.",
        difference=PaperDifference(
            False,
            "A number that says what is wrong costs no call of a model.",
            "868 planted faults repaired without a call (n = 879)",
        ),
    )
    critic: Literal["auto", "always", "never"] = option(
        "auto",
        "auto: where a model answers, show the critic key frames of checks that failed or only "
        "just passed, and try the reasoner's edits of what failed. always: show it every object in "
        "the two standard scenarios besides; a tape must hold its answers. never: ask nobody.",
        difference=PaperDifference("always", "Calls about objects that plainly pass find nothing."),
    )
    films: Literal["questionable", "always", "never"] = option(
        "questionable",
        "Write the two standard scenarios as GIFs for people: questionable, of objects with a "
        "check that failed or only just passed; always, of all; never.",
    )


class ComposeOptions(Options):
    """Step 4, scene composition."""

    refit: bool = option(
        True,
        "Before it, fit camera, positions, sizes and headings to the 2D boxes once more, by the "
        "built shapes. It acts only where `parse.fit` does.",
        difference=PaperDifference(
            False,
            "Built shapes fill their boxes otherwise than the cuboids of the first fit.",
            "box IoU as composed 0.895 and 0.878 (n = 3 photographs)",
        ),
    )
    settle: bool = option(
        True,
        "Let what lies tilted on a dish or a slope, or leans in a container, come to rest there by "
        "simulation; put what stands in a container, or covers it as a lid does, into it instead "
        "of on its rim, and clear of its walls, and move what leans, at its tilt, up to what it "
        "leans on, or back out of it.",
        difference=PaperDifference(
            False,
            "The search moves no tilts, and at its parsed tilt hardly anything rests.",
            "box IoU as composed 0.895 and 0.927, of coffee's spoon 0.62 and 0.91; two photographs "
            "have nothing to settle (n = 3 photographs)",
        ),
    )
    hold_joints: bool = option(
        True,
        "Raise the dry friction of joints that their weight would move from where the parse shows "
        "them.",
        difference=PaperDifference(
            False,
            "What stands half open in a photograph is held; the search moves no joints.",
            "joints move by themselves beyond the final check's bounds in 0 and in 7 of 42 objects "
            "(even starts of the benchmark's scenes)",
        ),
    )
    gap_m: float = option(
        1e-4,
        "Clearance left between a child and the surface that it is snapped onto.",
        unit="m",
        ge=0,
    )


class RenderOptions(Options):
    """Ray-cast pictures."""

    width: int = option(480, "Width of pictures.", unit="px", ge=16, le=8192)
    supersample: int = option(2, "Rays per pixel and axis at edges.", ge=1, le=4)
