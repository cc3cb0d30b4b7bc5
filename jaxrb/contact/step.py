"""The step with contact: what a method leaves of the bodies, corrected so that none overlap.

Bodies that contact pushes move with their new velocity from where the step began (x + dt v, Stewart and Trinkle 1996):
no overlap then arises along a straight path, momentum and angular momentum of bodies among themselves are kept to
round-off, and rest is rest. All others keep what the method gave them.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from jaxrb.body.state import State
from jaxrb.collision.touch import slots
from jaxrb.contact.block import Contacts
from jaxrb.contact.detection import Detected, detect
from jaxrb.contact.held import driven_motion, held, turning
from jaxrb.contact.impact import Course, closing, first_course, impact_scale
from jaxrb.contact.implicit import solve, solve_crowd
from jaxrb.contact.memory import Memory, first_memory, remembered
from jaxrb.contact.problem import Problem, motion_of, of_masses, world_inertia
from jaxrb.contact.report import ContactReport, first_report, reported
from jaxrb.contact.solution import Solution, crowd_tolerance, default_tolerance
from jaxrb.contact.surfaces import Meeting, Obstacle
from jaxrb.effects.rigid_contact import RigidContact
from jaxrb.effects.surfaces import Kind
from jaxrb.errors import WrongStructure
from jaxrb.math.arrays import Array, Scalar, Vector
from jaxrb.math.safe import norm
from jaxrb.math.vector import dot, matvec

# Rounds of impacts in one step: a blow runs through a row of so many bodies. What is left then goes on in the next.
_IMPACT_ROUNDS = 8
_BLOW = 1e-3  # tolerance of a blow over that of rest


class Carried(eqx.Module):
    """What contact carries from step to step: the impulses, from which the next solve starts, and the report."""

    memory: Memory
    report: ContactReport


class ContactStep(eqx.Module):
    """What of a scene may touch, and how a step is corrected for it."""

    rules: tuple[RigidContact, ...]
    kinds: tuple[Kind, ...]
    obstacles: tuple[Obstacle, ...]
    radius: Scalar  # (n,) [m] of a ball about each centre of mass that holds the shape
    pairs: tuple[Meeting, ...] = eqx.field(static=True)
    crowds: tuple[
        Any, ...
    ]  # each a `Crowd`; what only they need (`contact/crowd.py`) is loaded for them alone
    count: int = eqx.field(static=True)

    @property
    def meetings(self) -> tuple[Meeting, ...]:
        """The pairs of bodies that may ever touch.

        Raises:
            WrongStructure: of a crowd, whose pairs are not listed.
        """
        if self.crowds:
            raise WrongStructure(
                f"RigidContact: {self.count} bodies that meet each other are a crowd, whose pairs are found in each "
                "step anew; runs that look into single pairs cannot have them: use rb.rollout, or solver='newton'"
            )
        return self.pairs

    @property
    def room(self) -> int:
        """Points of a crowd that may press at a time."""
        from jaxrb.contact.crowd import room_for_points

        return room_for_points(self.kinds, self.obstacles, self.crowds)

    def first_memory(self, state: State) -> Carried:
        """What is carried into the first step."""
        if self.crowds:
            from jaxrb.contact.point_memory import first_points

            return Carried(first_points(self.room, state.dtype), first_report(state.dtype))
        pairs = [(self.kinds[obstacle.kind].shape, obstacle.shape) for obstacle in self.obstacles]
        pairs += [
            (self.kinds[one].shape, self.kinds[other].shape)
            for one, other in (m.kinds for m in self.meetings)
        ]
        points = max(slots(*pair) for pair in pairs)
        resists = any(rule.resists for rule in self.rules)
        memory = first_memory(self.obstacles, self.meetings, points + resists, state.dtype)
        return Carried(memory, first_report(state.dtype))

    def resolved(
        self, dynamics: Any, old: State, free: State, dt: Scalar, carried: Carried
    ) -> tuple[State, Carried]:
        """The state after the step in which contact has had its say."""
        free = dynamics.seen(free)  # with driven bodies where they end the step
        detected = self.detected(old, free, dt, carried.memory)
        problem, spin = self._problem(dynamics, old, free, detected, dt)
        start = motion_of(old)
        if dynamics.driven:
            start = driven_motion(start, dynamics.driven, old, free, dt)
        if problem.contacts.restitution is None:
            course = first_course(problem.free, problem.contacts)
            course, found = self._round(problem, course, start, detected.start, dt, None)
        else:
            course, found = self._rounds(problem, start, detected.start, dt)
        new = self._moved(dynamics, old, free, problem, course, found, spin, dt)
        report = reported(carried.report, problem, start, course, found)
        if self.crowds:
            from jaxrb.contact.point_memory import remembered_points

            memory = remembered_points(detected.chosen, found.impulse)
        else:
            memory = remembered(detected.contacts, detected.chosen, found.impulse)
        return new, Carried(memory, report.noting(detected.overflow))

    def detected(self, old: State, free: State, dt: Scalar, memory: Any) -> Detected:
        """The points that may touch in the step, and the impulses from which their solve starts."""
        reach = self._reach(old, free, dt)
        if self.crowds:
            from jaxrb.contact.crowd import detect_crowd

            return detect_crowd(self, old, reach, motion_of(free), dt, memory)
        return detect(self.rules, self.kinds, self.obstacles, self.meetings, old, reach, memory)

    def _problem(
        self, dynamics: Any, old: State, free: State, detected: Detected, dt: Scalar
    ) -> tuple[Problem, Vector]:
        """The problem at the start of the step, and the angular momentum (n, 3) in W that the free step ends with."""
        c = detected.contacts
        spin = free.orientation.rotate(dynamics.inertia.inertia.apply(free.angular_velocity))
        # Joints are closed, and moved along, at the end of the free step: only there do its velocities open none, and
        # what the joints do then is no work.
        pose, joints = (old, None) if dynamics.joints is None else (free, dynamics.joints)
        inertia, inverse = world_inertia(dynamics, pose.orientation)
        motion = jnp.concatenate([free.velocity, matvec(inverse, spin)], axis=1)
        problem = Problem(
            c,
            self._bias(c, c.distance, dt),
            dynamics.bodies.mass,
            inertia,
            dynamics.inverse_mass,
            inverse,
            motion,
            self._tolerance(motion.dtype, None),
            None if joints is None else joints.reactions(free, of_masses(dynamics.inverse_mass, inverse)),
        )
        if dynamics.freedoms is not None:
            problem = held(problem, dynamics, pose, old, free, dt)
        return problem, spin

    def _bias(self, contacts: Contacts, gap: Scalar, dt: Scalar) -> Scalar:
        """The least normal velocity that leaves no overlap at the end of the step."""
        # One slope on both sides of touch: with two, the corners of a face would ask for more than a plane can give.
        speed = jnp.min(jnp.stack([jnp.asarray(rule.recovery_speed) for rule in self.rules]))
        return contacts.at_points(jnp.minimum(-gap / dt, speed), 0.0)

    def _tolerance(self, dtype: Any, last: Any) -> Scalar:
        """Of a solve. What a blow misses is energy for good; a resting force is put right in the next step."""
        default = crowd_tolerance(dtype) if self.crowds else default_tolerance(dtype)
        resting = min((r.tolerance for r in self.rules if r.tolerance is not None), default=default)
        blow = max(_BLOW * resting, 4 * float(jnp.finfo(dtype).eps))
        return jnp.asarray(resting if last is None else jnp.where(last, resting, blow), dtype)

    def _round(
        self, problem: Problem, course: Course, start: Array, warm: Vector, dt: Scalar, last: Array | None
    ) -> tuple[Course, Solution]:
        """One solve: of impacts, or at `last` (None: there is no other) of all that rests on each other."""
        c = problem.contacts
        left = c.distance + dot(c.relative_velocity(course.shift - dt * course.jump), c.normal[:, None])
        bias, active, weight = self._bias(c, left, dt), c.active, dt
        if last is not None:
            hit, target, remaining = closing(problem, course, start, dt)
            # Who still comes in fast after the last round of impacts is left to the next step.
            bias = jnp.where(last, bias, target)
            active = jnp.where(last, active & ~hit, hit)
            weight = jnp.where(last, weight, remaining)
            warm = jnp.where(last, warm, 0.0)
        contacts = eqx.tree_at(lambda k: k.active, c, active)
        tolerance = self._tolerance(bias.dtype, last)
        own = eqx.tree_at(
            lambda p: (p.contacts, p.bias, p.free, p.tolerance),
            problem,
            (contacts, bias, problem.free + course.jump, tolerance),
        )
        found = (solve_crowd if self.crowds else solve)(own, lax.stop_gradient(warm))
        if last is not None:
            scale = jnp.where(last, 1.0, impact_scale(own, found, weight, start, problem.free, dt))
            impulse = scale * found.impulse
            found = eqx.tree_at(lambda f: f.impulse, found, impulse)
        return course.after(own, found, weight), found

    def _rounds(self, problem: Problem, start: Array, warm: Vector, dt: Scalar) -> tuple[Course, Solution]:
        def one(course: Course, last: Array) -> tuple[Course, Solution]:
            return self._round(problem, course, start, warm, dt, last)

        rounds = jnp.arange(_IMPACT_ROUNDS + 1) == _IMPACT_ROUNDS
        course, found = lax.scan(one, first_course(problem.free, problem.contacts), rounds)
        end = jax.tree.map(lambda leaf: leaf[-1], found)
        counts = (jnp.sum(n, dtype=jnp.int32) for n in (found.newton_steps, found.products))
        worst = (jnp.max(found.residual), jnp.any(found.poor), *counts)
        return course, eqx.tree_at(lambda f: (f.residual, f.poor, f.newton_steps, f.products), end, worst)

    def _reach(self, old: State, free: State, dt: Scalar) -> Scalar:
        """How far (n,) [m] any point of each body can move in the step."""
        speed = jnp.maximum(norm(old.velocity), norm(free.velocity))
        turning = jnp.maximum(norm(old.angular_velocity), norm(free.angular_velocity))
        return lax.stop_gradient(dt * (speed + turning * self.radius))

    def _moved(
        self,
        dynamics: Any,
        old: State,
        free: State,
        problem: Problem,
        course: Course,
        found: Solution,
        spin: Vector,
        dt: Scalar,
    ) -> State:
        impulse = problem.borne(problem.contacts.impulse_on_bodies(course.impulse))
        touched = jnp.any(impulse != 0, axis=-1)[:, None]
        rests = jnp.any(problem.borne(problem.contacts.impulse_on_bodies(found.impulse)) != 0, axis=-1)[
            :, None
        ]
        velocity = free.velocity + course.jump[:, :3]
        straight = old.position + dt * velocity + (course.shift - dt * course.jump)[:, :3]
        turn = free.orientation.unrotate(course.shift[:, 3:])
        orientation = free.orientation @ type(free.orientation).exp(turning(dynamics, turn))
        if problem.joints is not None:
            # A limb that leans on another is turned by its weight in the free step, and comes to rest only so.
            turned = dt * (problem.free + course.jump)[:, 3:] + (course.shift - dt * course.jump)[:, 3:]
            steadily = type(old.orientation).exp(turning(dynamics, old.orientation.unrotate(turned)))
            orientation = jax.tree.map(
                lambda straight, curved: jnp.where(
                    rests.reshape(-1, *(1,) * (curved.ndim - 1)), straight, curved
                ),
                old.orientation @ steadily,
                orientation,
            )
        omega = turning(dynamics, dynamics.inertia.response(orientation.unrotate(spin + impulse[:, 3:])))
        return State(
            jnp.where(rests, straight, free.position + course.shift[:, :3]),
            orientation,
            velocity,
            jnp.where(touched, omega, free.angular_velocity),
            free.time,
        )
