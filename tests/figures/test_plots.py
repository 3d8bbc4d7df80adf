"""The figures show the data that they were given, and do not change matplotlib's settings."""

import importlib
import re
import sys
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
from helpers.figures import legend, lines
from helpers.results import history, trajectory
from matplotlib.figure import Figure
from matplotlib.text import Text

import posegsa
from posegsa.figures import schedule_figures, search
from posegsa.figures import trajectory_figures as paths
from posegsa.figures.captioned import captioned
from posegsa.figures.result_figures import FIGURES as ALL
from posegsa.model.fuzzy import FuzzyController
from posegsa.optimisers import History

COVERED = ((0, 0, 0.1), (0.05, 0.1, 0.2), (0.15, 0.2, 0.3), (0.2, 0.4, 0.8), (0.6, 1, 1))
GAPPED = ((0, 0, 0.1), (0.125, 0.15, 0.2), (0.15, 0.2, 0.3), (0.5, 0.6, 0.8), (0.6, 1, 1))
OUTPUTS = ((0, 0, 10), (5, 15, 30), (20, 35, 50), (40, 60, 70), (65, 100, 100))
RULES = tuple(tuple(min(4, e + r) for e in range(5)) for r in range(5))


def controller(inputs=COVERED, outputs=OUTPUTS, **choices):
    terms = (jnp.array(triangles, jnp.float32) for triangles in (inputs, outputs))
    return FuzzyController(*terms, RULES, (0.0, 100.0), **choices)


FIGURES = {
    "input_terms": partial(schedule_figures.plot_input_terms, controller(GAPPED)),
    "output_terms": partial(schedule_figures.plot_output_terms, controller()),
    "surface": partial(schedule_figures.plot_surface, controller(GAPPED)),
    "convergence": partial(search.plot_convergence, history(non_finite=2)),
    "euler": partial(paths.plot_euler, trajectory()),
    "position": partial(paths.plot_position, trajectory()),
    "errors": partial(paths.plot_errors, trajectory()),
    "gain": partial(paths.plot_gain, trajectory()),
    "uncertainty": partial(paths.plot_uncertainty, trajectory()),
}


def assert_drawn(ax, *curves):
    """Assert that the lines of the axes are these curves (x, y), in this order."""
    assert len(ax.lines) == len(curves)
    for drawn, curve in zip(lines(ax), curves, strict=True):
        np.testing.assert_array_equal(drawn, curve)


@pytest.mark.parametrize("make", FIGURES.values(), ids=FIGURES)
def test_is_saved_with_a_unit_on_every_axis_and_no_trace_left(make, tmp_path):
    before = dict(matplotlib.rcParams)
    figure = make()
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "figure.png", dpi=50)
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before

    for ax in figure.axes:
        assert re.search(r"\[[^]]+\]", ax.get_ylabel()), ax
        below = [a for a in ax.get_shared_x_axes().get_siblings(ax) if a.get_xlabel()]
        colour_bar = ax.get_label() == "<colorbar>"
        assert colour_bar or all(re.search(r"\[[^]]+\]", a.get_xlabel()) for a in below or [ax])
        for text in (ax.yaxis.label, *ax.get_xticklabels(), *ax.get_yticklabels()):
            assert text.get_fontsize() >= 9


def test_pyplot_is_not_needed(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it raises
    monkeypatch.delattr(matplotlib, "pyplot", raising=False)
    for make in FIGURES.values():
        fresh = importlib.reload(sys.modules[make.func.__module__])
        getattr(fresh, make.func.__name__)(*make.args).draw_without_rendering()


def test_every_figure_of_a_result_has_its_words():
    assert len({each.name for each in ALL}) == len(ALL)
    for each in ALL:
        assert len(each.alternative) > 20
        assert len(each.caption) > 20
        assert each.title


def test_a_figure_of_no_part_of_a_result_is_refused():
    with pytest.raises(ValueError, match="lost: shows 'future'; allowed: one of"):
        captioned([], name="lost", title="", caption="")(lambda future: None)


def test_look_does_not_depend_on_the_users_settings():
    def look(figure):
        ax = figure.axes[0]
        label = ax.xaxis.label
        return (*figure.get_size_inches(), label.get_fontsize(), ax.lines[0].get_color())

    with matplotlib.rc_context({"font.size": 30, "figure.autolayout": True, "axes.grid": True}):
        changed = look(paths.plot_errors(trajectory()))
    assert changed == look(paths.plot_errors(trajectory()))


def test_terms_are_named_triangles():
    for figure, terms, high in (
        (schedule_figures.plot_input_terms(controller()), COVERED, 1),
        (schedule_figures.plot_output_terms(controller()), OUTPUTS, 100),
    ):
        (ax,) = figure.axes
        assert_drawn(ax, *((np.float32(term), (0, 1, 0)) for term in terms))
        assert [text.get_text() for text in ax.texts] == ["VS", "S", "M", "L", "VL"]
        np.testing.assert_allclose([text.xy[0] for text in ax.texts], [t[1] for t in terms], 1e-6)
        assert ax.get_ylim() == (0, 1)
        assert ax.get_xlim()[0] <= 0
        assert ax.get_xlim()[1] >= high


def test_names_of_close_peaks_do_not_overlap():
    close = ((0, 0, 0.1), (0.1, 0.15, 0.2), (0.1, 0.15, 0.2), (0.1, 0.16, 0.9), (0.3, 1, 1))
    figure = schedule_figures.plot_input_terms(controller(close))
    figure.draw_without_rendering()
    boxes = [Text.get_window_extent(text) for text in figure.axes[0].texts]
    for left, right in pairwise(boxes):
        assert left.x1 < right.x0


def test_other_numbers_of_terms_are_numbered():
    two = FuzzyController(
        jnp.array([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]]),
        jnp.array([[0.0, 0.0, 9.0], [0.0, 9.0, 9.0]]),
        ((0, 1), (1, 1)),
        (0.0, 9.0),
    )
    texts = schedule_figures.plot_input_terms(two).axes[0].texts
    assert [text.get_text() for text in texts] == ["1", "2"]


@pytest.mark.parametrize("choices", [{}, {"centroid": "sampled", "sampled_points": 101}])
def test_surface_is_the_controllers(choices):
    fuzzy = controller(**choices)
    ax, bar = schedule_figures.plot_surface(fuzzy).axes
    mesh = ax.collections[0]
    gain = np.ma.getdata(mesh.get_array())
    axis = np.linspace(0, 1, len(gain)) ** 2
    i = np.array([0, 7, 100, 200, 333, len(gain) - 1])
    gains = jax.jit(jax.vmap(lambda error, rate: fuzzy(error, rate)))
    expected = [gains(axis[i], np.full(len(i), rate)) for rate in axis[i]]
    np.testing.assert_allclose(gain[np.ix_(i, i)], expected, rtol=1e-4)
    assert np.ma.count_masked(mesh.get_array()) == 0
    assert bar.get_ylabel() == "Gain $K$ [1/s]"


@pytest.mark.parametrize(
    ("no_rule", "meaning"), [("hold", "the last gain is held"), ("midrange", "$K$ = 51 1/s")]
)
def test_surface_marks_where_no_rule_fires(no_rule, meaning):
    fuzzy = controller(GAPPED, no_rule=no_rule)
    figure = schedule_figures.plot_surface(fuzzy)
    assert legend(figure) == [f"no rule fires: {meaning}"]
    ax = figure.axes[0]
    drawn = ax.collections[0].get_array()
    axis = np.linspace(0, 1, len(drawn), dtype=np.float32) ** 2
    peaks, feet = np.array(GAPPED, np.float32)[:, 1], np.array(GAPPED, np.float32)[:, ::2]
    inside = (feet[:, :1] < axis) & (axis < feet[:, 1:])
    gap = ~(inside | (axis == peaks[:, None])).any(axis=0)
    np.testing.assert_array_equal(np.ma.getmaskarray(drawn), gap | gap[:, None])

    across = [p for p in ax.patches if p.get_height() == 1]
    down = [p for p in ax.patches if p.get_width() == 1]
    assert len(across) == len(down) == 2
    assert all(patch.get_hatch() for patch in ax.patches)
    for spans, start, size in ((across, "get_x", "get_width"), (down, "get_y", "get_height")):
        ends = [(getattr(p, start)(), getattr(p, start)() + getattr(p, size)()) for p in spans]
        np.testing.assert_allclose(ends, [(0.1, 0.125), (0.3, 0.5)], rtol=1e-6)


def test_gaps_are_marked_between_the_terms_too():
    figure = schedule_figures.plot_input_terms(controller(GAPPED))
    assert legend(figure) == ["no rule fires"]
    assert len(figure.axes[0].patches) == 2


def test_nothing_is_marked_where_rules_fire_everywhere():
    for figure in (
        schedule_figures.plot_surface(controller()),
        schedule_figures.plot_input_terms(controller()),
    ):
        assert not figure.legends
        assert not figure.axes[0].patches


@pytest.mark.parametrize(
    ("inputs", "outputs"),
    [
        pytest.param(COVERED, ((40, 50, 60),) * 5, id="flat"),
        pytest.param(((0, 0, 0),) * 5, OUTPUTS, id="no rule anywhere"),
        pytest.param(((0.25, 0.5, 0.75),) * 5, OUTPUTS, id="gaps at both ends"),
    ],
)
def test_surface_of_degenerate_controllers_is_drawn(inputs, outputs):
    schedule_figures.plot_surface(controller(inputs, outputs)).draw_without_rendering()


def test_convergence_shows_the_history():
    past = history()
    (ax,) = search.plot_convergence(past).axes
    iteration = np.arange(1, 41)
    assert_drawn(ax, *((iteration, values) for values in past[:3]))
    assert ax.get_yscale() == "linear"
    assert ax.get_ylim()[1] >= np.max(past.worst), "the worst costs are within the axes"
    assert ax.get_ylabel() == "Cost [-]"
    (ax,) = search.plot_convergence(past, unit="deg").axes
    assert ax.get_ylabel() == "Cost [deg]"


def test_convergence_takes_costs_that_are_not_finite():
    nan, inf = np.nan, np.inf
    past = History(
        *(np.array([inf, 50, 45, 45]), np.array([nan, 70, 60, 1e4])),
        *(np.array([nan, 90, inf, 1e9]), np.array([7, 0, 2, 1], np.int32)),
    )
    figure = search.plot_convergence(past)
    figure.draw_without_rendering()
    ax, below = figure.axes
    assert ax.get_yscale() == "log"
    assert ax.get_ylim()[1] == 1e6, "a cost of a diverged filter does not flatten the others"
    assert_drawn(
        ax, *(([1, 2, 3, 4], np.where(np.isfinite(values), values, nan)) for values in past[:3])
    )
    assert [bar.get_height() for bar in below.patches] == [7, 0, 2, 1]
    assert [bar.get_x() + bar.get_width() / 2 for bar in below.patches] == [1, 2, 3, 4]


def test_convergence_without_any_finite_cost_is_drawn():
    none = np.full(3, np.nan)
    past = History(np.full(3, np.inf), none, none, np.full(3, 9))
    search.plot_convergence(past).draw_without_rendering()


def test_pose_is_true_beside_estimated():
    run = trajectory()
    for figure, true, estimated in (
        (paths.plot_euler(run), run.euler, run.euler_est),
        (paths.plot_position(run), run.position, run.position_est),
    ):
        assert legend(figure) == ["true", "estimated"]
        assert len(figure.axes) == 3
        for i, ax in enumerate(figure.axes):
            assert_drawn(ax, (run.time, true[:, i]), (run.time, estimated[:, i]))
    labels = [ax.get_ylabel() for ax in paths.plot_euler(run).axes]
    assert labels == [r"Roll $\phi$ [deg]", r"Pitch $\theta$ [deg]", r"Yaw $\psi$ [deg]"]


def test_angles_break_at_wraps():
    angle = np.array([150, 170, -170, -150, 0, 179, -177, 180, -180.0])
    time = np.arange(9.0)
    run = trajectory(9, time=time, euler=np.tile(angle[:, None], 3))
    x, y = lines(paths.plot_euler(run).axes[0])[0]
    nan = np.nan
    np.testing.assert_allclose(
        y,
        (
            *(150, 170, 180, nan, -180, -170, -150, *[nan] * 3, 0, *[nan] * 3),
            *(179, 180, nan, -180, -177),
            *(-180, nan, 180, 180, 180, nan, -180, -180),
        ),
    )
    np.testing.assert_allclose(
        x,
        [0, 1, *[1.5] * 3, 2, 3, *[3.5] * 3, 4, *[4.5] * 3, 5, *[5.25] * 3, 6, *[7] * 7, 8],
    )
    assert np.nanmax(np.abs(np.diff(y))) <= paths.JUMP


def test_the_bands_are_two_sigma_and_the_errors_those_of_the_axes() -> None:
    run = trajectory()
    figure = paths.plot_uncertainty(run)
    assert figure is not None
    assert len(figure.axes) == 6
    off = run.position - run.position_est
    for i, ax in enumerate(figure.axes):
        error, sigma = (
            (run.attitude_parts[:, i], run.attitude_sigma[:, i])
            if i < 3
            else (100 * off[:, i - 3], 100 * run.position_sigma[:, i - 3])
        )
        np.testing.assert_allclose(ax.lines[0].get_ydata(), error)
        edge = ax.collections[0].get_paths()[0].vertices[:, 1]
        assert edge.max() == pytest.approx(2 * sigma.max())
        assert edge.min() == pytest.approx(-2 * sigma.max())


def test_without_a_covariance_there_is_no_figure_of_it() -> None:
    assert paths.plot_uncertainty(trajectory(attitude_sigma=np.full((301, 3), np.nan))) is None


def test_errors_are_drawn_over_logarithmic_axes():
    run = trajectory()
    run.position_error[5] = 0.0
    run.attitude_error[7:9] = np.inf, np.nan
    figure = paths.plot_errors(run)
    attitude, position = figure.axes
    finite = np.isfinite(run.attitude_error)
    assert_drawn(attitude, (run.time, np.where(finite, run.attitude_error, np.nan)))
    assert_drawn(position, (run.time, run.position_error))
    assert attitude.get_yscale() == position.get_yscale() == "log"
    figure.draw_without_rendering()


def test_gain_is_drawn_whole_and_enlarged():
    run = trajectory()
    whole, start = paths.plot_gain(run).axes
    assert_drawn(whole, (run.time, run.gain), (run.time, run.gain_used))
    assert_drawn(start, *((run.time[:101], gain[:101]) for gain in (run.gain, run.gain_used)))
    assert legend(paths.plot_gain(run)) == ["asked for", "used, after the limit"]


@pytest.mark.parametrize(("samples", "value"), [(1, 0.0), (100, 0.0), (100, np.nan)])
def test_short_runs_and_empty_values_are_drawn(samples, value):
    names = ("attitude_error", "position_error", "gain", "gain_used")
    run = trajectory(samples, **{name: np.full(samples, value) for name in names})
    for plot in (paths.plot_euler, paths.plot_position, paths.plot_errors, paths.plot_gain):
        plot(run).draw_without_rendering()
    assert len(paths.plot_gain(run).axes) == 1


@pytest.mark.parametrize(
    ("name", "what"), [("recommended", "velocities' noise"), ("disturbed", "a sensor's variance")]
)
def test_the_controller_of_a_kalman_filter_is_drawn_with_what_it_multiplies(name, what):
    result = posegsa.configured(name)
    role = {"recommended": "unknown", "disturbed": "belief"}[name]
    assert list(result.controllers) == [role]
    drawn = posegsa.draw(result, ["control_surface", "input_terms", "output_terms"])
    assert list(drawn) == ["control_surface", "input_terms", "output_terms"]
    _, bar = drawn["control_surface"].axes
    label = bar.get_ylabel()
    largest = getattr(result.tuned.filter, f"{role}_largest")
    assert what in label
    assert f"{largest:.0f}^{{(K-1)/100}}" in label
    assert "1/s" not in drawn["output_terms"].axes[0].get_xlabel()
