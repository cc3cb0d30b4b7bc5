"""Reading MJCF and URDF: looked through here, compiled by MuJoCo in a process of its own, built into a scene."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxrb.effects.effect import Effect
from jaxrb.effects.gravity import UniformGravity
from jaxrb.errors import InvalidInput, WrongStructure
from jaxrb.io.models.bodies import body_of, colliding, mass_properties, movers_of, placed, shapes_of
from jaxrb.io.models.child import compiled
from jaxrb.io.models.contact import contacts_of
from jaxrb.io.models.joints import joints_of
from jaxrb.io.models.model import Model
from jaxrb.io.models.reader import surveyed
from jaxrb.io.models.survey import Finding, Limits, Survey
from jaxrb.io.models.vocabulary import MJCF, Vocabulary
from jaxrb.io.models.vocabulary_urdf import URDF
from jaxrb.scene.example import Example
from jaxrb.scene.library import example_of
from jaxrb.scene.scene import Scene

Unsupported = Literal["refuse", "report"]
_SHOWN = 20  # findings in a message
_DURATION = 2.0  # [s] of a run of a file, which names none


def load_mjcf(
    file: str | os.PathLike,
    *,
    unsupported: Unsupported = "refuse",
    contact: bool = True,
    limit_stiffness: float | None = None,
    keyframe: str | int | None = None,
    root: str | os.PathLike | None = None,
    max_bodies: int = 10_000,
    max_bytes: int = 2**24,
    max_memory: int = 2**31,
    timeout: float = 60.0,
) -> Model:
    """Read a MuJoCo model (needs the extra [mjcf]).

    Masses, centres and inertias are those that MuJoCo compiles. A body's axes are the model's; its frame sits at the
    centre of mass of all that moves with it, and what is fixed to a body is part of it. What has no joint stands still:
    its geoms are obstacles. The compiler runs in a process of its own and is given what was understood, nothing else.

    Args:
        unsupported: "refuse" a file with anything that would change the motion and that jaxrb has not; "report" lists
            it in `Model.unsupported` and goes on without.
        contact: let bodies touch as the file says; False leaves contact out.
        limit_stiffness: [N m/rad or N/m] of joints' stops, which here are springs; without it stops are unsupported.
        keyframe: name or number of the keyframe to start from; None: the model's reference position at rest.
        root: folder in which all files must lie; by default that of the file.
        max_bodies, max_bytes, max_memory, timeout: refuse a model with more bodies, bytes of XML, bytes of memory or
            seconds of compiling.

    Raises:
        InvalidInput: a file that is not there, no XML, refused by MuJoCo, or with parts unsupported; each named with
            its line. LimitExceeded: beyond a limit.
    """
    limits = Limits(max_bodies, max_bytes, max_memory, timeout)
    return _load(Path(file), MJCF, limits, root, unsupported, contact, limit_stiffness, keyframe, None)


def load_urdf(
    file: str | os.PathLike,
    *,
    fixed: bool | None = None,
    unsupported: Unsupported = "refuse",
    contact: bool = True,
    limit_stiffness: float | None = None,
    root: str | os.PathLike | None = None,
    max_bodies: int = 10_000,
    max_bytes: int = 2**24,
    max_memory: int = 2**31,
    timeout: float = 60.0,
) -> Model:
    """Read a robot in URDF (needs the extra [mjcf]). Collision shapes are read, visual ones are not.

    Args:
        fixed: whether the first link stands still. By default it moves freely with its mass, unless named "world".
        contact: note that MuJoCo lets all links touch that are not neighbours.

    Others, and errors, as for `load_mjcf`. Meshes are named relative to the file; package://name/path is looked for
    as name/path and as path beside the file.
    """
    limits = Limits(max_bodies, max_bytes, max_memory, timeout)
    return _load(Path(file), URDF, limits, root, unsupported, contact, limit_stiffness, None, fixed)


def example_named(name: str) -> Example:
    """What commands run: a scene by its name or Python file, or a model by its file (.xml, .mjcf, .urdf).

    A model is run for two seconds by its own step.
    """
    kind = Path(name).suffix.lower()
    if kind not in (".xml", ".mjcf", ".urdf"):
        return example_of(name)
    model = load_urdf(name) if kind == ".urdf" else load_mjcf(name)
    return Example(model.name, name, model.scene, model.start, _DURATION, model.timestep)


def _load(
    file: Path,
    vocabulary: Vocabulary,
    limits: Limits,
    root: str | os.PathLike | None,
    unsupported: Unsupported,
    contact: bool,
    limit_stiffness: float | None,
    keyframe: str | int | None,
    fixed: bool | None,
) -> Model:
    if unsupported not in ("refuse", "report"):
        raise WrongStructure(f"unsupported={unsupported!r}: choose 'refuse' or 'report'")
    if not file.is_file():
        raise InvalidInput(f"{file}: there is no such file; give the path of a model")
    survey = surveyed(file, vocabulary, limits, file.parent if root is None else Path(root))
    strict = unsupported == "refuse"
    if strict:
        _refuse(file, survey.unsupported)
    free_root = vocabulary is URDF and not (
        survey.links - survey.children == {"world"} if fixed is None else fixed
    )
    answer = compiled(survey, free_root, keyframe)
    movers = movers_of(answer)
    if not movers:
        raise InvalidInput(f"{file}: nothing in it moves; give a body a joint or a freejoint")
    properties, shapes = mass_properties(answer, movers), shapes_of(answer, survey)
    centers = np.asarray([part.center_of_mass for part in properties])
    bodies = tuple(body_of(answer, m, part, shapes, survey) for m, part in zip(movers, properties))
    gravity = [UniformGravity(np.asarray(answer["gravity"]))] if any(answer["gravity"]) else []
    joints, names, findings = joints_of(answer, movers, centers, survey, limit_stiffness)
    touching, more = contacts_of(answer, movers, shapes, survey) if contact else ([], [])
    scene, last = _scene(file, bodies, [*gravity, *joints], touching)
    findings = [*survey.unsupported, *findings, *more, *last]
    if strict:
        _refuse(file, findings)
    return Model(
        file.stem if answer["name"] in ("", "MuJoCo Model") else answer["name"],
        scene,
        placed(answer, movers, centers),
        answer["timestep"],
        tuple(body.name for body in bodies),
        {name: (len(gravity) + value, row) for name, (value, row) in names.items()},
        tuple(findings),
        (*survey.ignored, *_unseen(answer, survey), *_told(answer, file)),
    )


def _scene(
    file: Path, bodies: tuple[Any, ...], effects: list[Effect], touching: Sequence[Effect]
) -> tuple[Scene, list[Finding]]:
    """The scene, without contact where the scene refuses it beside what else is in the file."""
    if touching:
        try:
            return Scene(bodies, (*effects, *touching)), []
        except WrongStructure as error:
            why = f"{error}; contact=False leaves contact out"
            return Scene(bodies, tuple(effects)), [Finding(file.name, 0, "contact", why)]
    return Scene(bodies, tuple(effects)), []


def _unseen(answer: Any, survey: Survey) -> list[Finding]:
    """Geoms that touch nothing, on bodies that have others which do: they are in no shape."""
    carriers = [answer["bodies"][geom["body"]]["carrier"] for geom in answer["geoms"]]
    solid = {carrier for carrier, geom in zip(carriers, answer["geoms"]) if colliding(geom)}
    return [
        Finding(
            *survey.place("geom", geom["name"]),
            f"geom[{geom['name']}]",
            "it touches nothing (contype, conaffinity)",
        )
        for carrier, geom in zip(carriers, answer["geoms"])
        if not colliding(geom) and (carrier in solid or carrier == 0)
    ]


def _told(answer: Any, file: Path) -> list[Finding]:
    return [
        Finding(file.name, 0, "mujoco", f"MuJoCo's compiler warns: {text}") for text in answer["warnings"]
    ]


def _refuse(file: Path, findings: Sequence[Finding]) -> None:
    if not findings:
        return
    shown = "\n".join(f"  {finding}" for finding in findings[:_SHOWN])
    more = f"\n  and {len(findings) - _SHOWN} more" if len(findings) > _SHOWN else ""
    raise InvalidInput(
        f"{file}: {len(findings)} parts are not supported:\n{shown}{more}\nunsupported='report' goes on without them, "
        "and lists them"
    )
