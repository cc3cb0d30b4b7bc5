"""What every command answers to: help with an example, JSON, precision, device, seed; and what it says of mistakes."""

import re

import jax
import numpy as np
import pytest

from jaxrb.cli import COMMANDS, main
from jaxrb.command_options import Common, with_common
from jaxrb.draws import drawn, seeded
from jaxrb.errors import InvalidInput
from jaxrb.scene.library import example_of

pytestmark = pytest.mark.skipif(
    not jax.config.read("jax_enable_x64"), reason="commands choose their own precision: once is enough"
)


def answered(arguments, capsys):
    """Exit code, and what was printed on either side."""
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    printed = capsys.readouterr()
    return stopped.value.code, printed.out, printed.err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_and_has_the_common_options(command, capsys):
    code, text, _ = answered([command, "--help"], capsys)
    assert code == 0
    assert re.search(rf"Example: .*jaxrb {command}\b", text)
    for option in ("--json", "--x64", "--float32", "--device", "--seed", "--debug"):
        assert re.search(rf"^\W*{option}\b", text, re.MULTILINE), f"{command} has no {option}"
    assert "\x1b" not in text  # colours are for terminals


def test_help_of_all_names_each_command_with_an_example(capsys):
    code, text, _ = answered(["--help"], capsys)
    assert code == 0
    assert text.count("Example:") >= len(COMMANDS)
    assert all(re.search(rf"^\W*{command}\b", text, re.MULTILINE) for command in COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["simlate", "stack_of_10"], 2, "did you mean simulate?"),
        (["simulate", "stack_of_11"], 1, "did you mean stack_of_10"),
        (["simulate", "stack_of_10", "--method", "RungeKuta4"], 1, "did you mean RungeKutta4"),
        (["plan", "hevy_top", "1e-6"], 1, "did you mean heavy_top"),
        (["simulate", "cube_toss", "--jsn"], 2, "--json"),
        (
            ["simulate", "cube_toss", "--device", "abacus"],
            1,
            "--device abacus: not on this machine; it has cpu",
        ),
        (["simulate", "cube_toss", "--device", "cpu:99"], 1, "this machine has cpu:0 to cpu:"),
        (["simulate", "cube_toss", "--x64", "--float32"], 1, "choose one precision"),
        (["simulate", "cube_toss", "--seed", "-1"], 1, "give a number from 0 on"),
        (["simulate", "cube_toss", "--seed", "one"], 2, "--seed"),
    ],
)
def test_mistakes_are_told_in_a_line_with_the_mend(arguments, code, words, capsys):
    stopped, _, errors = answered(arguments, capsys)
    assert stopped == code
    assert words in " ".join(re.sub("[│|]", " ", errors).split())
    assert "Traceback" not in errors


def test_common_options_hold_within_a_command_and_not_after_it():
    def looked() -> tuple:
        """Looks."""
        return jax.numpy.ones(1).dtype, drawn().random(), next(iter(jax.numpy.ones(1).devices()))

    before = looked()
    last = jax.devices("cpu")[-1]
    one = with_common(looked)(
        common=Common(float32=True, seed=7, device=f"cpu:{len(jax.devices('cpu')) - 1}")
    )
    assert one[0] == np.float32
    assert one[2] == last
    other = with_common(looked)(common=Common(seed=8))
    assert other[0] == np.float64
    assert len({before[1], one[1], other[1]}) == 3
    assert looked() == before
    with pytest.raises(InvalidInput, match="one precision"):
        with_common(looked)(common=Common(float32=True, x64=True))


def test_scenes_follow_the_seed_and_are_those_of_the_figures_without_one():
    places = [np.asarray(example_of("stack_of_10").start["position"])]
    for seed in (0, 1, 1, 2):
        with seeded(seed):
            places.append(np.asarray(example_of("stack_of_10").start["position"]))
    usual, none, one, again, two = places
    np.testing.assert_array_equal(usual, none)
    np.testing.assert_array_equal(one, again)
    assert usual[0, :2] == pytest.approx(np.random.default_rng(0).uniform(-0.01, 0.01, (10, 2))[0])
    assert min(np.abs(one - usual).max(), np.abs(one - two).max()) > 1e-3
