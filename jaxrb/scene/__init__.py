"""Floor 6: the public heart."""

from jaxrb.scene.flight import free_flight as free_flight
from jaxrb.scene.path import Path as Path
from jaxrb.scene.rollout import rollout as rollout
from jaxrb.scene.scene import Scene as Scene
from jaxrb.scene.scene import angular_momentum as angular_momentum
from jaxrb.scene.scene import energy as energy
from jaxrb.scene.scene import momentum as momentum
from jaxrb.scene.solve import solve as solve
from jaxrb.scene.step import step as step
from jaxrb.scene.step import stepper as stepper
