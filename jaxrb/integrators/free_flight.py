"""Torque-free rotation of one body over any time, in closed form, with a derivative of its own.

The values are elliptic functions (`free_flight_motion`) and an elliptic integral of the third kind
(`free_flight_attitude`); the derivative is the variational equation, solved (`free_flight_tangent`).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.inertia import Inertia, PrincipalInertia, SphericalInertia
from jaxrb.errors import WrongStructure
from jaxrb.integrators.free_flight_attitude import angle, angle_lanes, attitude, orbit_of
from jaxrb.integrators.free_flight_motion import Frame, Motion, Triple, frame_of, motion_of
from jaxrb.integrators.free_flight_tangent import integral_lanes, tangent_of
from jaxrb.integrators.principal_frame import principal_frame
from jaxrb.math.arrays import Scalar, Vector, components, stack
from jaxrb.math.elliptic import carlson
from jaxrb.math.quaternion import Quaternion
from jaxrb.math.vector import matvec


def free_rotation(inertia: Inertia, angular_velocity: Vector, time: Scalar) -> tuple[Quaternion, Vector]:
    """How one body turns without torque.

    Args:
        inertia: of one body.
        angular_velocity: at the start, (3,) in the body frame [rad/s].
        time: () [s], of either sign and any length.

    Returns:
        The rotation from the body frame after `time` to the body frame at the start (the orientation R_WB becomes
        R_WB times it), and the angular velocity after `time`, (3,) in the body frame [rad/s].
    """
    if isinstance(inertia, SphericalInertia):
        return Quaternion.exp(angular_velocity * time), angular_velocity
    if isinstance(inertia, PrincipalInertia):
        moments = jnp.asarray(inertia.moments)
        wxyz, omega = principal_rotation(angular_velocity, moments, jnp.zeros_like(moments), time)
        return Quaternion(wxyz), omega
    # The result does not depend on which frame diagonalises the tensor, so the frame is a constant to derivatives;
    # they pass through the tensor seen from it, products of inertia included.
    axes = lax.stop_gradient(principal_frame(inertia.six()))
    across = jnp.swapaxes(axes, -1, -2)
    moments, products = _seen_from(axes, inertia.six())
    wxyz, omega = principal_rotation(matvec(across, angular_velocity), moments, products, time)
    turned = jnp.concatenate([wxyz[..., :1], matvec(axes, wxyz[..., 1:])], axis=-1)
    return Quaternion(turned), matvec(axes, omega)


@jax.custom_jvp
def principal_rotation(
    omega: Vector, moments: Vector, products: Vector, time: Scalar
) -> tuple[jax.Array, Vector]:
    """Rotation as wxyz (4,) and ω (3,) after `time`, in principal axes.

    `products` are the entries yz, xz, xy of the tensor (3,): zero in principal axes, and ignored; only their variations
    count. The derivative is defined at every input, equal moments, pure spin, rest and the separatrix included.
    """
    inertia, spin = _units(omega, moments)
    frame, motion = _moved(omega / spin, moments / inertia, time * spin)
    orbit = orbit_of(motion)
    psi = angle(motion, orbit, *carlson(*angle_lanes(orbit, motion.clock)))
    return _turned_back(frame, attitude(motion, orbit, psi)), spin * stack(*frame.back(motion.omega_then))


@principal_rotation.defjvp
def _rotation_jvp(primals: Any, tangents: Any) -> Any:
    omega, moments, _, time = (_once(primal) for primal in primals)
    domega, dmoments, dproducts, dtime = tangents
    inertia, spin = _units(omega, moments)
    frame, motion = _moved(omega / spin, moments / inertia, time * spin)
    orbit = orbit_of(motion)
    first, third = carlson(*angle_lanes(orbit, motion.clock).with_more(integral_lanes(motion.clock)))
    wxyz = attitude(motion, orbit, angle(motion, orbit, first, third))
    dwxyz, dthen = tangent_of(
        motion,
        wxyz,
        third[3:],
        frame.seen(_triple(domega / spin)),
        frame.seen_diagonal(_triple(dmoments / inertia)),
        frame.seen_others(_triple(dproducts / inertia)),
        dtime * spin,
    )
    then = stack(*frame.back(motion.omega_then))
    return (_turned_back(frame, wxyz), spin * then), (
        _turned_back(frame, dwxyz),
        spin * stack(*frame.back(_triple(dthen))),
    )


def _units(omega: Vector, moments: Vector) -> tuple[Scalar, Scalar]:
    """Powers of two near the largest moment and near |Iω| over it: dividing by them rounds nothing, and keeps the
    products of float32 in range. A body that hardly turns has the least unit whose cube is a normal number."""
    kind = jnp.finfo(moments.dtype)

    def power(x: Scalar) -> Scalar:
        return lax.reduce_precision(x, exponent_bits=kind.nexp, mantissa_bits=0)

    inertia = power(jnp.max(moments))
    spin = jnp.max(jnp.abs(moments / inertia * omega))
    return inertia, power(jnp.maximum(spin, float(kind.tiny) ** (1.0 / 3.0)))


def _moved(omega: Vector, moments: Vector, time: Scalar) -> tuple[Frame, Motion]:
    frame, seen_moments, seen_omega = frame_of(moments, omega)
    return frame, motion_of(seen_moments, seen_omega, time)


def _turned_back(frame: Frame, wxyz: jax.Array) -> jax.Array:
    """The rotation in the body's axes."""
    w, x, y, z = components(wxyz)
    return stack(w, *frame.back((x, y, z)))


def _triple(array: Vector) -> Triple:
    x, y, z = components(array)
    return x, y, z


def _seen_from(axes: Any, six: Any) -> tuple[Vector, Vector]:
    """Diagonal, and entries yz, xz, xy, of the tensor in a frame given by its axes as columns: Aᵀ I A."""
    xx, yy, zz, xy, xz, yz = components(six)
    columns = [components(axes[..., :, j]) for j in range(3)]
    applied = [
        (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z) for x, y, z in columns
    ]

    def entry(i: int, j: int) -> Scalar:
        return sum((a * b for a, b in zip(columns[i], applied[j], strict=True)), jnp.zeros_like(xx))

    return stack(*(entry(i, i) for i in range(3))), stack(entry(1, 2), entry(0, 2), entry(0, 1))


@jax.custom_jvp
def _once(x: Any) -> Any:
    """x, which may not be differentiated again."""
    return x


@_once.defjvp
def _refused(primals: Any, tangents: Any) -> Any:
    raise WrongStructure(
        "free_flight: it has first derivatives only (grad, jacfwd, jacrev); for a Hessian use differences of the "
        "gradient, or differentiate rb.rollout twice"
    )
