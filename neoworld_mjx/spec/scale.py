"""The one law of isotropic scaling: how every physical quantity of an object follows its size.

Gravity and densities do not scale, so time goes with sqrt(s) (Froude similarity) and, with the
mass exponent m (3 for a derived mass, 0 for an authored one), dimensional analysis gives

    quantity                     turning joint       sliding joint
    position, limits             0                   1
    armature                     m + 2  (inertia)    m      (mass)
    stiffness                    m + 1  (torque)     m - 1  (force / length)
    damping                      m + 3/2             m - 1/2
    friction loss, effort        m + 1  (torque)     m      (force)
    velocity limit               -1/2                1/2

where torque = mass g length and force = mass g. Lengths go with s, inertia with m + 2. A joint
takes the mass exponent of its child part.
"""

from .object import AuthoredInertia, JointSpec, Mimic, ObjectSpec, PartSpec

LENGTH = 1.0
DERIVED_MASS, AUTHORED_MASS = 3.0, 0.0


def mass_exponent(part: PartSpec) -> float:
    """Return the power of s that the part's mass follows."""
    return DERIVED_MASS if part.mass is None else AUTHORED_MASS


def joint_exponents(joint: JointSpec, child: PartSpec) -> dict[str, float]:
    """Return the power of s that each quantity of a joint follows, by field name of `Joint`."""
    m = mass_exponent(child)
    if joint.type == "prismatic":
        return {
            "lower": 1.0,
            "upper": 1.0,
            "armature": m,
            "stiffness": m - 1.0,
            "damping": m - 0.5,
            "friction": m,
            "effort": m,
            "velocity": 0.5,
        }
    return {
        "lower": 0.0,
        "upper": 0.0,
        "armature": m + 2.0,
        "stiffness": m + 1.0,
        "damping": m + 1.5,
        "friction": m + 1.0,
        "effort": m + 1.0,
        "velocity": -0.5,
    }


def mimic_exponents(joint: JointSpec, leader: JointSpec) -> tuple[float, float]:
    """Return the powers of s of a mimic's (multiplier, offset).

    q = multiplier * q_leader + offset, where sliding joints count in metres.
    """
    own = 1.0 if joint.type == "prismatic" else 0.0
    led = 1.0 if leader.type == "prismatic" else 0.0
    return own - led, own


def scale(spec: ObjectSpec, s: float) -> ObjectSpec:
    """Return the object scaled isotropically by `s` about its origin.

    Raises:
        ValueError: `s` is not a positive finite number.
    """
    if not 0 < s < float("inf"):
        raise ValueError(f"scale must be positive and finite, got {s}")
    joints = {joint.name: joint for joint in spec.joints}
    parts = tuple(
        part.model_copy(
            update={
                "geoms": tuple(
                    geom.model_copy(
                        update={
                            "shape": geom.shape.scaled(s),
                            "pos": tuple(v * s for v in geom.pos),
                        }
                    )
                    for geom in part.geoms
                ),
                "inertia": part.inertia and _scale_inertia(part.inertia, s),
            }
        )
        for part in spec.parts
    )
    return spec.model_copy(
        update={
            "parts": parts,
            "joints": tuple(_scale_joint(spec, j, joints, s) for j in spec.joints),
            "sites": tuple(
                site.model_copy(update={"pos": tuple(v * s for v in site.pos)})
                for site in spec.sites
            ),
        }
    )


def _scale_inertia(inertia: AuthoredInertia, s: float) -> AuthoredInertia:
    """Spread the same mass over the new size."""
    times = lambda values, factor: tuple(v * factor for v in values)
    return AuthoredInertia(
        pos=times(inertia.pos, s),
        moments=times(inertia.moments, s**2),
        products=times(inertia.products, s**2),
    )


def _scale_joint(
    spec: ObjectSpec, joint: JointSpec, joints: dict[str, JointSpec], s: float
) -> JointSpec:
    update: dict[str, object] = {"pos": tuple(v * s for v in joint.pos)}
    for name, power in joint_exponents(joint, spec.part(joint.child)).items():
        value = getattr(joint, name)
        update[name] = None if value is None else value * s**power
    if joint.mimic is not None:
        multiplier, offset = mimic_exponents(joint, joints[joint.mimic.joint])
        update["mimic"] = Mimic(
            joint=joint.mimic.joint,
            multiplier=joint.mimic.multiplier * s**multiplier,
            offset=joint.mimic.offset * s**offset,
        )
    if joint.intent is not None and joint.intent.travel is not None and joint.type == "prismatic":
        travel = joint.intent.travel * s
        update["intent"] = joint.intent.model_copy(update={"travel": travel})
    return joint.model_copy(update=update)
