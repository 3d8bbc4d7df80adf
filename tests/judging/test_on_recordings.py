"""The text of a result on recordings."""

import numpy as np
import pytest

from posegsa.judging.evaluation import IMU_AS_IT_COMES
from posegsa.judging.on_recordings import OnRecordings, RecordingScore, shares
from posegsa.recordings.accuracy import Blocks, Rmse
from posegsa.recordings.broad import GYROSCOPE


def scores(total: float, position: float | None) -> list[RecordingScore]:
    """A filter on one recording, with these errors [deg, m]."""
    judged = Rmse(total=total, heading=total, inclination=0.0, position=position, samples=9)
    blocks = Blocks([total**2] * 3, None if position is None else [position**2] * 3)
    about = ("walk", 9, 0.9, position is None, {}, [], {"judged": judged}, "0" * 64)
    return [RecordingScore(*about, blocks=blocks)]


def verdict(own: tuple[float, float | None], **others: tuple[float, float | None]) -> str:
    beside = {name.replace("_", " "): scores(*errors) for name, errors in others.items()}
    judged = OnRecordings(training=[], held_out=scores(*own), baselines=beside)
    return judged.verdict()


def test_filters_that_err_less_are_named_the_best_first() -> None:
    words = verdict((0.31, 0.0287), invariant_EKF=(0.12, 0.014), VQF=(0.2, None), other=(0.4, 0.05))
    assert words.startswith("On what was held out the filter errs by 0.31 deg and 2.87 cm.")
    assert "invariant EKF (39 % in attitude, 49 % in position); VQF (65 % in attitude)" in words
    assert "other" not in words


def test_one_that_is_better_in_position_alone_is_named_too() -> None:
    assert "EKF (150 % in attitude, 50 % in position)" in verdict((0.2, 0.02), EKF=(0.3, 0.01))


def test_where_none_is_better_it_says_so() -> None:
    words = verdict((0.2, None), VQF=(0.199, None), Madgwick=(0.5, None))
    assert (
        "errs by 0.2 deg. No other filter (VQF, Madgwick) errs less: take it, `posegsa export"
    ) in words


def test_what_is_true_of_all_recordings_is_said_once() -> None:
    (one,) = scores(0.2, None)
    same, own = {"gyroscope": "measured"}, {"velocity": "simulated"}
    each = [one._replace(name="a", sources=same), one._replace(name="b", sources=same | own)]
    told = OnRecordings(training=each[:1], held_out=each[1:]).origins().splitlines()
    assert told == ["gyroscope: measured", "b: velocity: simulated"]
    alone = OnRecordings(training=[], held_out=each[:1]).origins()
    assert alone == "a: gyroscope: measured"


def test_a_phase_that_is_all_that_is_judged_has_no_row() -> None:
    (one,) = scores(0.2, None)
    still = one.errors["judged"]._replace(total=0.1)
    each = {"judged": one.errors["judged"], "rest": still, "motion": one.errors["judged"]}
    judged = OnRecordings(training=[], held_out=[one._replace(errors=each)])
    assert [row[2] for row in judged.rows()] == ["phase", "judged: motion", "rest"]


def test_that_shipped_numbers_were_chosen_on_broad_is_said() -> None:
    (one,) = scores(0.2, None)
    (other,) = scores(0.4, None)
    broad = one._replace(sources={"angular velocity": GYROSCOPE})
    for own, told in ((one, False), (broad, True)):
        beside = {IMU_AS_IT_COMES: [other]}
        judged = OnRecordings(
            training=[], held_out=[own], baselines=beside, baselines_in_training=beside
        )
        assert ("chosen on trials of BROAD" in judged.verdict()) == told
        heads = [row[0] for row in judged.rows()[1:]]
        assert heads == [
            "attitude filter as it comes, training",
            "held out",
            "attitude filter as it comes, held out",
        ]


def test_without_other_filters_there_is_no_verdict() -> None:
    assert verdict((0.2, 0.1)) == ""


def test_intervals_of_shares_are_those_of_paired_blocks() -> None:
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.5, 1.5, 12)  # parts of the recording, for both filters

    def filter(scale: float, noise: float) -> list[RecordingScore]:
        squares = (scale * hard * (1 + noise * rng.standard_normal(12))) ** 2
        (one,) = scores(float(np.sqrt(np.mean(squares))), None)
        return [one._replace(blocks=Blocks(squares.tolist(), None))] * 2

    (half,) = shares(filter(1.0, 0.0), filter(0.5, 0.0)).values()
    assert half == pytest.approx((0.5, 0.5, 0.5)), (
        "a recording that is hard for both makes no difference"
    )
    (alike,) = shares(filter(1.0, 0.5), filter(0.9, 0.5)).values()
    assert alike.low < 1 < alike.high
    assert "maybe by chance" in str(alike)
    few = [one._replace(blocks=Blocks([1.0] * 3, None)) for one in filter(1.0, 0.0)]
    assert np.isnan(shares(few, few)["attitude"].low)
