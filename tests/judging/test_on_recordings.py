"""The text of a result on recordings."""

import re

import numpy as np
import pytest

from posegsa.judging.evaluation import IMU_AS_IT_COMES
from posegsa.judging.on_recordings import OnRecordings, RecordingScore, losses, mean_errors
from posegsa.judging.verdict import Loss
from posegsa.judging.verdict import verdict as sentence
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


def test_filters_that_err_less_are_named_the_largest_loss_first() -> None:
    words = verdict((0.31, 0.0287), VQF=(0.2, None), invariant_EKF=(0.12, 0.014), other=(0.4, 0.05))
    few = "(too few data for an interval)"
    assert words.startswith(
        f"Best on what was held out: invariant EKF, which errs 0.19 deg less {few} and 1.47 cm "
        f"less {few} than this filter, 0.31 deg and 2.87 cm; then VQF, 0.11 deg less {few}. That "
        "may be chance"
    )
    assert "other" not in words


def test_one_that_is_better_in_position_alone_is_named_too() -> None:
    words = verdict((0.2, 0.02), EKF=(0.3, 0.01))
    assert re.search(r"EKF, which errs 0.1 deg more .* and 1 cm less", words)


def test_one_that_is_better_for_sure_is_to_be_taken_and_how() -> None:
    sure, chance = Loss(0.5, 0.2, 0.8, "deg"), Loss(0.5, -0.2, 1.2, "deg")
    advice = {"EKF": "`posegsa tune kalman`"}
    words = sentence("these", "1 deg", {"EKF": [sure]}, {}, advice)
    errs = "EKF, which errs 0.5 deg less (95 % interval 0.2 to 0.8) than this filter, 1 deg."
    assert words.endswith(f"{errs} Take it: `posegsa tune kalman`.")
    words = sentence("these", "1 deg", {"EKF": [chance]}, {}, advice)
    assert words.startswith(
        "On these no filter is surely better than this one, 1 deg. EKF errs 0.5 deg less "
        "(95 % interval -0.2 to 1.2). Judge on more data"
    )
    assert "Take it" not in words


def test_where_none_is_better_it_says_so() -> None:
    words = verdict((0.2, None), Madgwick=(0.5, None), VQF=(0.199, None))
    assert words.startswith(
        "As good as any on what was held out: this filter, 0.2 deg. The next, VQF, errs 0.001 deg "
        "less (too few data for an interval). Also compared: Madgwick. Take this filter: "
    )
    assert "`posegsa export" in words
    words = verdict((0.2, None), Madgwick=(0.5, None))
    assert words.startswith("Best on what was held out: this filter, 0.2 deg. The next, Madgwick")


def test_a_filter_that_is_lost_loses() -> None:
    assert verdict((90.0, np.inf), EKF=(0.3, 0.01)).startswith("Best on what was held out: EKF")


@pytest.mark.parametrize(
    ("nis", "told"), [(4.42, True), (1.9, False), (np.inf, False), (None, False)]
)
def test_sensors_far_from_their_prediction_are_told_of(nis: float | None, told: bool) -> None:
    (one,) = scores(2.8, 0.22)
    one.errors["judged"] = one.errors["judged"]._replace(nis=nis)
    words = " ".join(OnRecordings(training=[], held_out=[one], baselines={}).warnings())
    assert ("2.1 times as far from their prediction" in words) == told
    assert ("`posegsa tune --recording FILE --set filter.belief=ramp`" in words) == told


def test_without_a_judged_recording_nothing_is_warned_of() -> None:
    assert OnRecordings(training=[], held_out=[], baselines={}).warnings() == []


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


def test_intervals_are_those_of_paired_blocks() -> None:
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.5, 1.5, 12)  # parts of the recording, for both filters

    def filter(scale: float, noise: float) -> list[RecordingScore]:
        squares = (scale * hard * (1 + noise * rng.standard_normal(12))) ** 2
        (one,) = scores(float(np.sqrt(np.mean(squares))), None)
        return [one._replace(duration=60.0, blocks=Blocks(squares.tolist(), None))] * 2

    (half,) = losses(filter(1.0, 0.0), filter(0.5, 0.0))
    mean = filter(1.0, 0.0)[0].errors["judged"].total
    assert half.mean == pytest.approx(0.5 * mean)
    spread = 0.5 * np.std(hard**2) / (2 * mean) / np.sqrt(12) / np.sqrt(2)
    assert half.high - half.low == pytest.approx(2 * 1.96 * spread, rel=0.15)
    assert half.sure
    (alike,) = losses(filter(1.0, 0.5), filter(0.9, 0.5))
    assert alike.low < 0 < alike.high
    words = sentence("these", "1 deg", {"EKF": [alike]}, {}, {})
    assert words.startswith("On these no filter is surely better than this one, 1 deg.")
    few = [one._replace(blocks=Blocks([1.0] * 3, None)) for one in filter(1.0, 0.0)]
    assert np.isnan(losses(few, few)[0].low)
    # The short blocks of a short recording are for a figure: neighbours are correlated.
    short = [one._replace(duration=10.0) for one in filter(1.0, 0.0)]
    assert np.isnan(losses(short, short)[0].low)


def test_the_mean_of_several_recordings_has_their_nees_and_nis() -> None:
    own = [
        score._replace(errors={"judged": score.errors["judged"]._replace(nees=nees, nis=1.0)})
        for score, nees in ((*scores(0.2, 0.02), 5.0), (*scores(0.4, 0.04), 8.0))
    ]
    assert mean_errors(own).nees == 6.5
    assert mean_errors(scores(0.2, 0.02)).nees is None
    table = OnRecordings(training=[], held_out=own).table()
    assert table.splitlines()[-1].split()[-2:] == ["6.5", "1"]
    assert "NEES" not in OnRecordings(training=[], held_out=scores(0.2, 0.02)).table()
