"""jaxrb: differentiable rigid-body dynamics in JAX that is honest about its accuracy.

The facade: names only. Importing it changes no setting of JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

from jaxrb.accuracy.rollout import rollout
from jaxrb.body import (
    Body,
    Freedom,
    FullInertia,
    Inertia,
    MassProperties,
    PrincipalInertia,
    SphericalInertia,
    State,
    principal_axes,
    replicate,
    valid_inertia,
)
from jaxrb.compilation import compiler_options as compiler_options
from jaxrb.compilation_cache import enable_compilation_cache
from jaxrb.effects import (
    AngularSpring,
    BodyThruster,
    Buoyancy,
    CentralGravity,
    CompliantContact,
    CustomForce,
    Effect,
    FixedPoint,
    Force,
    GravityGradient,
    LinearDrag,
    MagneticTorque,
    MagnusForce,
    Motor,
    MutualGravity,
    PlateAerodynamics,
    PrescribedMotion,
    PrescribedTorque,
    QuadraticDrag,
    RigidContact,
    SpringDamper,
    UniformGravity,
    WindField,
    Wrench,
)
from jaxrb.errors import (
    InvalidInput,
    JaxrbError,
    JaxrbWarning,
    LimitExceeded,
    NotIdentifiable,
    RunFailed,
    RunInterrupted,
    UnknownName,
    WrongStructure,
)
from jaxrb.geometry import (
    Box,
    Capsule,
    Composite,
    Cone,
    ConvexHull,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Pose,
    Shape,
    Sphere,
    TriangleMesh,
    convex_decomposition,
    stack_hulls,
)
from jaxrb.integrators import (
    METHODS,
    ExplicitEuler,
    ImplicitMidpoint,
    Method,
    MoserVeselov,
    MoserVeselov4,
    MoserVeselov6,
    RungeKutta4,
    SemiImplicitEuler,
    ThreeAxisSplitting,
    ThreeAxisSplitting4,
    VelocityVerlet,
)
from jaxrb.math import (
    Drift,
    EulerAngles,
    Quaternion,
    Rotation,
    RotationMatrix,
    attitude_error,
    hat,
    slerp,
    vee,
)
from jaxrb.scene import (
    Path,
    Scene,
    angular_momentum,
    energy,
    free_flight,
    momentum,
    solve,
    step,
    stepper,
)
from jaxrb.view.viewer import View, view

if TYPE_CHECKING:
    from jaxrb.accuracy.cost import CostReport, cost
    from jaxrb.accuracy.gradient_check import gradient_check
    from jaxrb.accuracy.gradient_check_report import GradientCheck
    from jaxrb.accuracy.memory import MemoryEstimate, memory
    from jaxrb.accuracy.planner import Plan, plan
    from jaxrb.accuracy.recommend import Recommendation, recommend
    from jaxrb.accuracy.smoothed_gradient import smoothed_gradient
    from jaxrb.accuracy.smoothed_gradient_report import SmoothedGradient
    from jaxrb.collision import Contact, separation
    from jaxrb.fit import InertiaFit, ParametersNotIdentifiable, RatiosNotIdentifiable, SceneFit, fit_inertia
    from jaxrb.fit import fit_scene as fit
    from jaxrb.io import Recording, read_mesh, read_recording, replay, run, write_recording
    from jaxrb.io.models import Model, load_mjcf, load_urdf
    from jaxrb.joints import (
        BallJoint,
        Distance,
        Hinge,
        Joint,
        JointLimit,
        JointMotor,
        JointServo,
        JointSpring,
        Slider,
        Weld,
    )
    from jaxrb.scene.adams import SmoothPath, solve_smooth
    from jaxrb.scene.adaptive import AdaptivePath, solve_contact
    from jaxrb.scene.events import EventPath, solve_events
    from jaxrb.scene.joints import assembled, joint_error, joint_reactions
    from jaxrb.scene.worlds import WorldPaths, rollout_worlds
    from jaxrb.view.glb_animation import save_glb
    from jaxrb.view.live import LiveView, view_live

__version__ = "0.1.0"

# Loaded when first asked for: not every program fits a recording or plans a run, and `import jaxrb` is waiting time.
_LATER = {
    "Contact": "jaxrb.collision",
    "separation": "jaxrb.collision",
    "CostReport": "jaxrb.accuracy.cost",
    "cost": "jaxrb.accuracy.cost",
    "GradientCheck": "jaxrb.accuracy.gradient_check_report",
    "gradient_check": "jaxrb.accuracy.gradient_check",
    "MemoryEstimate": "jaxrb.accuracy.memory",
    "memory": "jaxrb.accuracy.memory",
    "Recommendation": "jaxrb.accuracy.recommend",
    "recommend": "jaxrb.accuracy.recommend",
    "SmoothedGradient": "jaxrb.accuracy.smoothed_gradient_report",
    "smoothed_gradient": "jaxrb.accuracy.smoothed_gradient",
    "Plan": "jaxrb.accuracy.planner",
    "plan": "jaxrb.accuracy.planner",
    "InertiaFit": "jaxrb.fit",
    "ParametersNotIdentifiable": "jaxrb.fit",
    "RatiosNotIdentifiable": "jaxrb.fit",
    "SceneFit": "jaxrb.fit",
    "fit_inertia": "jaxrb.fit",
    "Recording": "jaxrb.io",
    "Model": "jaxrb.io.models",
    "load_mjcf": "jaxrb.io.models",
    "load_urdf": "jaxrb.io.models",
    "read_mesh": "jaxrb.io",
    "read_recording": "jaxrb.io",
    "replay": "jaxrb.io",
    "run": "jaxrb.io",
    "write_recording": "jaxrb.io",
    "BallJoint": "jaxrb.joints",
    "Distance": "jaxrb.joints",
    "Hinge": "jaxrb.joints",
    "Joint": "jaxrb.joints",
    "JointLimit": "jaxrb.joints",
    "JointMotor": "jaxrb.joints",
    "JointServo": "jaxrb.joints",
    "JointSpring": "jaxrb.joints",
    "Slider": "jaxrb.joints",
    "Weld": "jaxrb.joints",
    "assembled": "jaxrb.scene.joints",
    "joint_error": "jaxrb.scene.joints",
    "joint_reactions": "jaxrb.scene.joints",
    "SmoothPath": "jaxrb.scene.adams",
    "solve_smooth": "jaxrb.scene.adams",
    "WorldPaths": "jaxrb.scene.worlds",
    "rollout_worlds": "jaxrb.scene.worlds",
    "AdaptivePath": "jaxrb.scene.adaptive",
    "solve_contact": "jaxrb.scene.adaptive",
    "EventPath": "jaxrb.scene.events",
    "solve_events": "jaxrb.scene.events",
    "save_glb": "jaxrb.view.glb_animation",
    "LiveView": "jaxrb.view.live",
    "view_live": "jaxrb.view.live",
}


def __getattr__(name: str) -> Any:
    if name == "fit":  # the package: calling it fits a scene
        return importlib.import_module("jaxrb.fit")
    if name not in _LATER:
        raise AttributeError(f"module 'jaxrb' has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER, "fit"})
