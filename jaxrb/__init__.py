"""jaxrb: differentiable rigid-body dynamics in JAX that is honest about its accuracy.

The facade: names only. Importing it changes no setting of JAX.
"""

from jaxrb.body import (
    Body,
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
from jaxrb.effects import (
    BodyThruster,
    CustomForce,
    Effect,
    FixedPoint,
    Force,
    LinearDrag,
    PrescribedTorque,
    QuadraticDrag,
    SpringDamper,
    UniformGravity,
    Wrench,
)
from jaxrb.errors import (
    InvalidInput,
    JaxrbError,
    JaxrbWarning,
    LimitExceeded,
    NotIdentifiable,
    RunFailed,
    UnknownName,
    WrongStructure,
)
from jaxrb.fit import InertiaFit, RatiosNotIdentifiable, fit_inertia
from jaxrb.geometry import Box, Capsule, Composite, Cone, Cylinder, Ellipsoid, Pose, Shape, Sphere
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
from jaxrb.io import Recording, read_recording, write_recording
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
    rollout,
    solve,
    step,
    stepper,
)

__version__ = "0.1.0"
