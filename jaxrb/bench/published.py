"""Figures that others published, with their source beside each. Carried over as data; nothing here is computed."""

import dataclasses
from typing import Any

_NESC = "NASA/TM-2015-218675, check case 2; data in simupy-flight's NESC_data"
_GAZEBO = "scpeters/benchmark, BENCHMARK_boxes_dt.csv, complex, 1 box"
_OURS = "measured with MuJoCo 4.0 on this test; this command reproduces it where MuJoCo is installed"
_MJX = "measured with MJX on this test; not re-run by this command, and taken to be at the end as MuJoCo's figures are"


@dataclasses.dataclass(frozen=True)
class Published:
    """One result as its authors give it: who, in which setting, the figures by name, and where it stands."""

    who: str
    setting: str
    figures: dict[str, float]
    source: str

    def entry(self) -> dict[str, Any]:
        """As a line of a row of the scoreboard."""
        plain = {"who": self.who, "setting": self.setting, **self.figures}
        return plain | {"published": True, "source": self.source}


def _rate(who: str, setting: str, error: float, energy: float, source: str) -> Published:
    # MuJoCo's figures are those at the end (re-running shows it); its largest over the run is about a tenth more.
    figures = {"body_rate_deg_s" if source is _NESC else "body_rate_end_deg_s": error}
    return Published(who, setting, figures if energy == 0.0 else figures | {"energy": energy}, source)


TUMBLING_BRICK = tuple(
    _rate(*row)
    for row in (
        ("NASA SIM 1", "", 3.6e-10, 0.0, _NESC),
        ("NASA SIM 2", "", 1.24e-3, 0.0, _NESC),
        ("NASA SIM 4", "", 3.3e-10, 0.0, _NESC),
        ("NASA SIM 5", "", 5.8e-5, 0.0, _NESC),
        ("NASA SIM 6", "", 4.7e-3, 0.0, _NESC),
        ("MuJoCo Euler", "dt 0.01", 0.406, 9.4e-3, _OURS),
        ("MuJoCo implicitfast", "dt 0.01", 0.395, 9.0e-3, _OURS),
        ("MuJoCo RK4", "dt 0.01", 2.4e-10, 0.0, _OURS),
        ("MJX Euler", "dt 0.01", 0.406, 9.4e-3, _MJX),
        ("MJX implicitfast", "dt 0.01", 0.406, 9.4e-3, _MJX),
        ("MJX RK4 float32", "dt 0.01", 2.0e-4, 0.0, _MJX),
        ("MJX RK4 float64", "dt 0.01", 4.3e-9, 0.0, _MJX),
    )
)


def _box(
    who: str, dt: str, position: float, angular_momentum: float, energy: float, source: str
) -> Published:
    figures = {"position_m": position, "angular_momentum": angular_momentum, "energy": energy}
    return Published(who, f"dt {dt}", figures, source)


GAZEBO_BOXES = tuple(
    _box(*row)
    for row in (
        ("ODE", "1e-4", 0.0049, 1.2715e-3, 1.24711e-3, _GAZEBO),
        ("Bullet", "1e-4", 0.0049, 1.25827e-3, 1.3586e-3, _GAZEBO),
        ("Simbody", "1e-4", 0.00245, 6.34808e-4, 6.2358e-4, _GAZEBO),
        ("DART", "1e-4", 0.0049, 2.229, 2.69e-2, _GAZEBO),
        ("MuJoCo RK4", "1e-4", 4.1e-10, 3.4e-14, 1.7e-10, _OURS),
        ("ODE", "1e-3", 0.049, 1.30708e-2, 1.2462e-2, _GAZEBO),
        ("Bullet", "1e-3", 0.049, 1.24501e-2, 1.35771e-2, _GAZEBO),
        ("Simbody", "1e-3", 0.0245, 6.43471e-3, 6.23355e-3, _GAZEBO),
        ("DART", "1e-3", 0.049, 2.186, 3.76e-2, _GAZEBO),
        ("MuJoCo RK4", "1e-3", 4.0e-11, 2.7e-11, 1.7e-11, _OURS),
    )
)

# J. Hwangbo, J. Lee; metrics in its benchmark/include. What an engine cannot be told to do it has no figure for.
_SIMBENCHMARK = "SimBenchmark, leggedrobotics 2018"


def _by_step(
    name: str, steps: tuple[str, ...], results: dict[str, tuple[float, ...]]
) -> tuple[Published, ...]:
    return tuple(
        Published(who, f"dt {dt}", {name: figure}, _SIMBENCHMARK)
        for i, dt in enumerate(steps)
        for who, figure in ((who, figures[i]) for who, figures in results.items())
    )


BOUNCING = _by_step(
    "energy_j2",
    ("1e-3", "1e-4", "1e-5"),
    {
        "RaiSim": (1.86e-2, 1.86e-6, 1.86e-10),
        "ODE": (185.0, 1.85, 1.85e-2),
        "DART": (7.23e4, 483.0, 7.39),
        "Bullet": (7.52e4, 752.0, 7.52),
    },
)
ROLLING = tuple(
    Published(who, f"{direction}, dt 1e-3", {"both": figures[i]}, _SIMBENCHMARK)
    for i, direction in enumerate(("y", "oblique"))
    for who, figures in {
        "RaiSim": (4.13e-7, 4.14e-7),
        "Bullet": (4.9e-9, 5.7e-9),
        "ODE": (7.7e-9, 3.145),
        "DART": (0.426, 3.145),
        "MuJoCo Newton Euler": (9.2e-3, 6.9e-3),
        "MuJoCo Newton RK4": (3.2e-3, 2.7e-3),
    }.items()
)
INELASTIC_666 = _by_step(
    "overlap_m2",
    ("1e-3", "1e-2"),
    {
        "RaiSim": (1.35e-4, 0.0153),
        "ODE": (1.55e-4, 0.0161),
        "DART": (2.8e-4, 215.0),
        "MuJoCo Newton": (0.0950, 0.934),
        "Bullet": (0.382, 37.4),
    },
)
ELASTIC_666 = _by_step(
    "energy_j2",
    ("1e-4", "1e-3", "1e-2"),
    {
        "RaiSim": (0.0011, 8.37, 5.2e6),
        "ODE": (1.10, 112.0, 8.6e6),
        "Bullet": (168.0, 4.1e4, 9.9e6),
        "DART": (2438.0, 3.5e5, 1.3e10),
    },
)

# MuJoCo 4.0.0 from the first recorded state, 400 other tosses of the same set, means over each trajectory.
_TOSSES = "400 other tosses of the same set; see the recordings' README"
CUBE_TOSSES = tuple(
    Published("MuJoCo 4.0", setting, {"position_mm": position, "attitude_deg": angle}, _TOSSES)
    for setting, position, angle in (
        ("default contact", 102.0, 40.5),
        ("default with friction 0.18", 29.4, 22.1),
        ("contact learned by the recordings' authors", 26.3, 21.9),
        ("stiffness, damping, friction fitted", 26.3, 21.3),
        ("and metric scale and inertia", 25.1, 20.5),
    )
)

# The end values that any correct program must reach: deg/s and wxyz at 30 s; rad/s and wxyz at 10 s; at t = 10.
TUMBLING_BRICK_END = {
    "angular_velocity_deg_s": (12.61839078, -17.39747476, 31.11958889),
    "orientation": (-0.88114719, 0.47018253, 0.01172825, 0.04868754),
}
GAZEBO_BOX_END = {
    "angular_velocity": (2.7558404, -3.73596352, -3.161809),
    "orientation": (0.22516456, -0.61992756, -0.27702915, 0.69874572),
    "energy_at_start": 368.5464125,
}
# E. Hairer, S. P. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", II.0; SciMLBenchmarks, "Rigid body".
# The benchmark publishes curves, not numbers; what it publishes is the problem.
RIGID_BODY_END = (-0.66886242, -0.5876984, 2.01077739)
