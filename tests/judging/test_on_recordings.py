"""What a result on recordings says in words."""

from posegsa.judging.on_recordings import OnRecordings, RecordingScore
from posegsa.recordings.accuracy import Rmse


def scores(total: float, position: float | None) -> list[RecordingScore]:
    """A filter on one recording, with these errors [deg, m]."""
    judged = Rmse(total=total, heading=total, inclination=0.0, position=position, samples=9)
    return [RecordingScore("walk", 9, 0.9, position is None, {}, [], {"judged": judged}, "0" * 64)]


def verdict(own: tuple[float, float | None], **others: tuple[float, float | None]) -> str:
    beside = {name.replace("_", " "): scores(*errors) for name, errors in others.items()}
    judged = OnRecordings(training=[], held_out=scores(*own), baselines=beside)
    assert judged.verdict() in judged.text(0.0)
    return judged.verdict()


def test_filters_that_err_less_are_named_the_best_first() -> None:
    words = verdict((0.31, 0.0287), invariant_EKF=(0.12, 0.014), VQF=(0.2, None), other=(0.4, 0.05))
    assert words.startswith("On what was held out the filter errs by 0.31 deg and 2.87 cm.")
    assert "invariant EKF (39 % in attitude and 49 % in position), VQF (65 % in attitude)" in words
    assert "other" not in words


def test_one_that_is_better_in_position_alone_is_named_too() -> None:
    assert "EKF (150 % in attitude and 50 % in position)" in verdict((0.2, 0.02), EKF=(0.3, 0.01))


def test_where_none_is_better_it_says_so() -> None:
    words = verdict((0.2, None), VQF=(0.199, None), Madgwick=(0.5, None))
    assert words.endswith(
        "errs by 0.2 deg. No filter beside it errs less, in attitude or in position."
    )


def test_without_other_filters_there_is_no_verdict() -> None:
    assert verdict((0.2, 0.1)) == ""
