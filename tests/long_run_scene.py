"""A small run with everything that is carried from step to step, for tests of its files."""

import jaxrb as rb

# Every stretch is written, whatever that costs.
SETTINGS = {
    "dt": 1e-3,
    "save_every": 7,
    "chunk": 50,
    "overhead": 1e9,
    "method": rb.RungeKutta4(compensated=True),
}


def free():
    """Two tumbling bricks with drag, and compensated sums."""
    brick = rb.replicate(rb.Body.from_shape(rb.Box((0.10, 0.05, 0.02)), density=700.0), 2)
    effects = (rb.UniformGravity(), rb.QuadraticDrag(coefficient=0.4, area=0.02))
    scene = rb.Scene(brick, effects)
    return scene, scene.state(angular_velocity=[(0.0, 5.0, 0.1), (3.0, 0.1, 0.1)])


def touching():
    """A ball that is thrown along a floor: contact's memory is carried too."""
    ball = rb.Body.from_shape(rb.Sphere(0.05), density=700.0)
    scene = rb.Scene(ball, (rb.UniformGravity(), rb.RigidContact(rb.HalfSpace(), friction=0.3)))
    return scene, scene.state(position=(0, 0, 0.06), velocity=(1.0, 0, 0), angular_velocity=(0.3, 0.2, 1.0))
