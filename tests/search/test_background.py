"""Work in the background."""

import jax
import jax.numpy as jnp
import pytest

from posegsa import steps
from posegsa.search.background import in_background


def test_it_returns_what_the_work_returns():
    assert in_background(lambda: 6 * 7)() == 42


def test_the_caller_gets_the_exception_of_the_work():
    wait = in_background(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        wait()


@pytest.mark.parametrize("wide", [False, True])
def test_the_work_has_the_floating_types_of_the_caller(wide):
    with jax.enable_x64(wide):
        found = in_background(lambda: jnp.asarray(1.0).dtype)()
    assert found == (jnp.float64 if wide else jnp.float32)


def test_only_the_steps_of_the_caller_are_reported():
    told: list[str] = []
    with steps.listening(lambda step: told.append(step.name)):
        steps.begin("mine")
        in_background(lambda: steps.begin("theirs"))()
        steps.share(0.5)
    assert told == ["mine", "mine"]
