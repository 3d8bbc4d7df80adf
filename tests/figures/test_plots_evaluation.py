"""The figures of an evaluation show its data."""

import re
from dataclasses import replace
from functools import partial

import matplotlib
import numpy as np
import pytest
from helpers.figures import legend, lines
from helpers.results import ANGLES, OF_THE_OBSERVER, TIME, changed, evaluation, trust
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from posegsa.figures import evaluation_figures as plots
from posegsa.figures import schedule_figures, style
from posegsa.figures.style import START
from posegsa.judging.evaluation import (
    CONSTANT,
    EKF,
    EKF_VECTORS,
    RANDOM,
    SWITCH,
    TUNED,
    UNTUNED,
)
from posegsa.judging.metrics import Bands

pytestmark = pytest.mark.quick

CURVES = (TUNED, CONSTANT, SWITCH, EKF_VECTORS, UNTUNED)
"""The contenders that are drawn over time."""
SPREAD = evaluation(initial_angle=ANGLES)
FIGURES = {
    "costs": partial(plots.plot_costs, evaluation()),
    "bands": partial(plots.plot_bands, evaluation()),
    "angles": partial(plots.plot_angles, SPREAD),
    "rules": partial(schedule_figures.plot_rules, trust()),
}


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
def test_is_saved_with_units_on_its_axes_and_no_trace_left(make, tmp_path):
    before = dict(matplotlib.rcParams)
    figure = make()
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "figure.png", dpi=50)
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before
    labels = [text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel()) if text]
    assert len(labels) >= 2
    for text in labels:
        assert re.search(r"\[[^]]+\]", text), text


def test_costs_are_every_scenario_of_every_contender():
    given = evaluation()
    ax, below = plots.plot_costs(given).axes
    points = [c.get_offsets() for c in ax.collections if len(c.get_offsets()) == 40]
    assert len(points) == len(given.contenders)
    for row, (one, drawn) in enumerate(zip(given.contenders.values(), points, strict=True)):
        drawn = np.asarray(drawn)
        np.testing.assert_array_equal(drawn[:, 0], one.metrics.cost)
        assert (np.abs(drawn[:, 1] - row) < 0.5).all()
    means = [x for x, _ in lines(ax) if len(x) == 1]
    np.testing.assert_array_equal(np.ravel(means), [given.cost(n).mean for n in OF_THE_OBSERVER])
    intervals = [x for x, y in lines(ax) if len(x) == 2]
    np.testing.assert_array_equal(intervals, [given.cost(n)[1:] for n in OF_THE_OBSERVER])

    others = list(OF_THE_OBSERVER)[1:]
    means = [x for x, _ in lines(below) if len(x) == 1]
    np.testing.assert_array_equal(np.ravel(means), [given.difference(n).mean for n in others])
    for text, name in zip(below.texts, others, strict=True):
        mean, low, high = given.difference(name)
        assert text.get_text() == f"{mean:+.2f} [{low:+.2f}, {high:+.2f}]"


def test_infinite_costs_are_counted_and_left_out():
    cost = np.linspace(40, 50, 40)
    cost[[3, 7, 11]] = np.inf
    given = changed(evaluation((TUNED, CONSTANT)), CONSTANT, cost=cost)
    figure = plots.plot_costs(given)
    figure.draw_without_rendering()
    ax, below = figure.axes
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names == [TUNED, "best constant\ngains\n(3 of 40 infinite)"]
    sizes = [len(c.get_offsets()) for c in ax.collections]
    assert 37 in sizes
    assert [text.get_text() for text in below.texts] == ["not finite"]


def test_costs_far_apart_are_drawn_over_a_logarithmic_axis():
    far = changed(evaluation((TUNED, CONSTANT)), CONSTANT, cost=np.geomspace(40, 1e5, 40))
    assert plots.plot_costs(far).axes[0].get_xscale() == "log"
    assert plots.plot_costs(evaluation(cost=np.full(40, 44.0))).axes[0].get_xscale() == "linear"


def test_nothing_finite_and_one_contender_are_drawn():
    nothing = evaluation((TUNED, CONSTANT), cost=np.full(40, np.inf), initial_angle=ANGLES)
    empty = Bands(*np.full((3, 3, len(TIME)), np.nan))
    for name, one in nothing.contenders.items():
        nothing.contenders[name] = one._replace(bands=empty)
    for plot in (plots.plot_costs, plots.plot_bands, plots.plot_angles):
        figure = plot(nothing)
        assert figure is not None
        figure.draw_without_rendering()
    (ax,) = plots.plot_costs(evaluation((TUNED,))).axes
    assert [text.get_text() for text in ax.get_yticklabels()] == [TUNED]


def test_one_difference_far_from_the_others_leaves_them_their_room():
    given = evaluation((TUNED, CONSTANT, SWITCH, EKF))
    cost = given.contenders[TUNED].metrics.cost
    for name, more in ((CONSTANT, 1.0), (SWITCH, 4.0), (EKF, 1000.0)):
        given = changed(given, name, cost=cost + more)
    below = plots.plot_costs(given).axes[1]
    across = below.transData + below.transAxes.inverted()
    far, near, nearest = (across.transform((-x, 0))[0] for x in (1000.0, 4.0, 1.0))
    assert 0 <= far < near < nearest < 1
    assert nearest - near > 0.05  # 0.003 on a linear axis
    assert plots.plot_costs(evaluation((TUNED, CONSTANT))).axes[1].get_xscale() == "linear"


def test_bands_are_the_quantiles_of_four_contenders():
    given = evaluation()
    figure = plots.plot_bands(given)
    assert legend(figure) == [*CURVES, "thin: 95 %"]
    labels = [ax.get_ylabel() for ax in figure.axes if ax.get_ylabel()]
    assert labels == ["Attitude error [deg]", "Position error [m]", "Gain used $K$ [1/s]"]
    start = TIME <= START
    for i, ax in enumerate(figure.axes):
        row, part = i // 2, start if i % 2 == 0 else slice(None)
        assert ax.get_yscale() == ("linear" if row == 2 else "log")
        curves = iter(lines(ax))
        for j, name in enumerate(CURVES):
            low, middle, high = given.contenders[name].bands[row]
            np.testing.assert_array_equal(next(curves), (TIME[part], middle[part]))
            if name in (TUNED, CONSTANT):
                drawn = ax.collections[j].get_paths()[0].vertices
                assert set(low[part]) | set(high[part]) <= set(drawn[:, 1])
            else:  # their bands would hide these
                np.testing.assert_array_equal(next(curves), (TIME[part], high[part]))


def test_bands_without_some_of_them_and_of_a_short_run_are_drawn():
    figure = plots.plot_bands(evaluation((TUNED, CONSTANT, RANDOM)))
    assert legend(figure) == [TUNED, CONSTANT]
    given = evaluation((TUNED, CONSTANT))
    short = replace(given, time=TIME / 15)
    assert len(plots.plot_bands(short).axes) == 3


def test_angles_show_every_scenario_and_the_running_median():
    (ax,) = plots.plot_angles(SPREAD).axes
    cost = SPREAD.contenders[TUNED].metrics.cost
    points, median = lines(ax)[:2]
    np.testing.assert_array_equal(points, (ANGLES, cost))
    np.testing.assert_array_equal(median[0], ANGLES)
    around = [np.median(cost[max(0, i - 7) : i + 8]) for i in range(40)]
    np.testing.assert_allclose(median[1], around)


def test_angles_mark_infinite_costs_at_their_angle():
    cost = np.full(40, 44.0)
    cost[-9:] = np.inf
    given = changed(SPREAD, TUNED, cost=cost)
    figure = plots.plot_angles(given)
    figure.draw_without_rendering()
    assert legend(figure) == [f"{TUNED} (9 infinite)", *CURVES[1:-1]]
    points, median, marked = lines(figure.axes[0])[:3]
    np.testing.assert_array_equal(np.isnan(points[1]), np.isinf(cost))
    assert np.isnan(median[1][-1]), "where most costs are infinite the line ends"
    np.testing.assert_array_equal(marked[0], ANGLES[-9:])


def test_angles_that_do_not_differ_are_not_drawn():
    assert plots.plot_angles(evaluation()) is None
    two = evaluation((TUNED, CONSTANT), cost=np.array([4.0, 5.0]), initial_angle=ANGLES[:2])
    plots.plot_angles(two).draw_without_rendering()


def test_a_contender_looks_the_same_in_all_figures():
    ax, _ = plots.plot_costs(SPREAD).axes
    points = [c for c in ax.collections if len(c.get_offsets()) == 40]
    bands = [one for one in plots.plot_bands(SPREAD).axes[0].lines if one.get_label() in CURVES]
    rows = [list(SPREAD.contenders).index(name) for name in CURVES]
    for of_cost, of_bands in zip((points[i] for i in rows), bands, strict=True):
        assert to_rgba(of_cost.get_facecolor()[0][:3]) == to_rgba(of_bands.get_color())


def test_any_number_of_curves_can_be_told_apart():
    looks = {str(style.curve(i)) for i in range(2 * len(style.CURVES))}
    assert len(looks) == 2 * len(style.CURVES)
    assert [style.curve(i) for i in range(len(style.CURVES))] == list(style.CURVES)


def test_rules_show_each_weight_and_name_what_never_fires():
    figure = schedule_figures.plot_rules(trust())
    ax, bar = figure.axes
    shown = ax.images[0].get_array()
    np.testing.assert_array_equal(np.ma.filled(shown, 0), trust().rule_weights)
    texts = {text.get_position(): text.get_text() for text in ax.texts}
    assert texts[(1, 0)] == "0.25"
    assert texts[(4, 3)] == "0.013"
    assert list(texts.values()).count("never") == 23
    for labels in (ax.get_xticklabels(), ax.get_yticklabels()):
        assert [text.get_text() for text in labels] == ["VS", "S", "M", "L", "VL"]
    assert ax.get_xlabel().startswith("Term of the scaled error")
    assert ax.get_ylabel().startswith("Term of the scaled rate")
    assert bar.get_ylabel() == "Mean firing strength [-]"
    schedule_figures.plot_rules(trust(rule_weights=np.zeros((5, 5)))).draw_without_rendering()
