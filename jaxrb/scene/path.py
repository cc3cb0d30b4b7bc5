"""The result of a run."""

from typing import Any

import equinox as eqx
import jax

from jaxrb.body.state import State
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.rotation import Drift
from jaxrb.scene.certificate import Certificate
from jaxrb.scene.scene import Scene, angular_momentum, energy, momentum
from jaxrb.scene.start import warn_of_overlap
from jaxrb.scene.status import Status


class Diagnostics(eqx.Module):
    """Conserved quantities at each saved time.

    energy (k,) [J], momentum (k, 3) [kg m/s], angular_momentum (k, 3) [kg m²/s] about the world's origin, all of the
    whole scene; drift (k, n) of each body's representation.
    """

    energy: Scalar
    momentum: Vector
    angular_momentum: Vector
    drift: Drift


class Path(eqx.Module):
    """A run: `times` (k,) [s], the saved `states` (leading axis k), the `final` state and the `status`.

    `certificate` holds the estimated errors of a run that was asked to `certify`; `contact` what contact did up to each
    saved time (a `ContactReport` with leading axis k), None in a scene without contact.
    """

    times: Array
    states: State
    final: State
    status: Status
    scene: Scene
    certificate: Certificate | None = None
    contact: Any = None

    @property
    def diagnostics(self) -> Diagnostics:
        """Conserved quantities at the saved times; computed when asked for, so a run that is not asked pays nothing."""
        return _diagnose(self.scene, self.states)

    def raise_if_bad(self) -> None:
        """Raise `RunFailed` if the status is not good: for paths that come out of `jit` or `vmap`.

        Warns of bodies that overlapped deeply.
        """
        self.status.raise_if_bad()
        warn_of_overlap(self.scene, self.contact)


@jax.jit
def _diagnose(scene: Scene, states: State) -> Diagnostics:
    def at(state: State) -> Diagnostics:
        return Diagnostics(
            energy(scene, state),
            momentum(scene, state),
            angular_momentum(scene, state),
            state.orientation.drift(),
        )

    return jax.vmap(at)(states)
