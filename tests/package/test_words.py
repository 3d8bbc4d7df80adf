"""Formatting of text: similar names, and short texts of what a user prints."""

import numpy as np
import pytest
from helpers.recordings import bench

import posegsa
from posegsa.errors import ArgumentError, ConfigError
from posegsa.figures.figure_choice import chosen_figures
from posegsa.words import meant

pytestmark = pytest.mark.quick


def test_the_most_similar_name_is_suggested():
    assert meant("recomended", ["observer", "recommended"]) == "; did you mean recommended?"
    assert meant("xyz", ["observer"]) == ""


def test_a_configuration_and_a_figure_are_suggested():
    with pytest.raises(ConfigError, match=r"did you mean recommended\?"):
        posegsa.load_config("recomended")
    with pytest.raises(ArgumentError, match=r"did you mean angles\?"):
        chosen_figures(["anglse"], ["costs", "angles"])


def test_what_a_user_prints_is_a_line():
    recording = posegsa.Recording.from_arrays(**bench(200))
    (replayed,) = posegsa.replay("kalman", [recording])
    stream = posegsa.PoseFilter("imu")
    shown = [replayed, replayed.estimates, posegsa.check(recording), stream, recording]
    for one in shown:
        assert len(repr(one)) < 200, repr(one)
        assert "\n" not in repr(one)
    assert f"{replayed.errors.rmse()['judged'].total:.3g} deg" in repr(replayed)
    assert "200 samples" in repr(replayed.estimates)
    assert "at 0 s" in repr(stream)
    assert np.shape(replayed.estimates.time) == (200,)
