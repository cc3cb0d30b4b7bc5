"""The picture of `jaxrb simulate`: a run at a glance."""

from typing import Any

import numpy as np

from jaxrb.scene.example import Example
from jaxrb.scene.path import Path
from jaxrb.view.figures import new_figure
from jaxrb.view.side_view import draw_side, side_of


def simulation_figure(path: Path, example: Example) -> Any:
    """Heights and energy over time, and the bodies at the end from the side."""
    figure = new_figure((11.0, 5.6))
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.25))
    heights, energies = left.subplots(2, 1, sharex=True)
    times, position = np.asarray(path.times), np.asarray(path.states.position)
    heights.plot(times, position[..., 2], linewidth=0.9)
    heights.set(ylabel="heights of the bodies [m]", title=f"{example.name}: {example.about}")
    energy = np.asarray(path.diagnostics.energy, float)
    energies.plot(times, energy - energy[0], "k", label="energy since the start")
    if path.contact is not None:
        energies.plot(times, path.contact.normal_work, "C0--", label="work of contact, normal")
        energies.plot(times, path.contact.friction_work, "C1--", label="work of contact, friction")
    energies.set(xlabel="time [s]", ylabel="[J]")
    energies.legend(fontsize=8)
    for axes in (heights, energies):
        axes.grid(alpha=0.3)
    side = right.subplots()
    across = side_of(example.scene, path.states)
    draw_side(side, example.scene, path.final, across)
    side.set(title=f"at {float(path.final.time):.3g} s, from the side")
    return figure
