"""Where panels stand: all words fit into the figure, and no panel's words reach into another."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from posegsa.figures import style
from posegsa.figures.room import Room


def numbers_of_all_sizes() -> Figure:
    figure, axes = style.grid(2, 2, 4.0, sharex="col", width_ratios=(2, 3))
    x = np.linspace(0, 1, 50)
    axes[0, 0].plot(x, 1e-4 * x, label="a short name")
    axes[1, 0].plot(x, -12345 * x)
    axes[0, 1].plot(120 * x, x, label="a long name that takes most of a line of the legend")
    style.scale_errors(axes[1, 1], 10 ** (6 * x - 3))
    axes[1, 1].plot(120 * x, 10 ** (6 * x - 3), label="another such long name for the legend")
    for ax in axes.flat:
        ax.set_ylabel("Attitude error [deg]")
    for ax in axes[1]:
        ax.set_xlabel("Time [s]")
    style.legend_above(figure, axes[0, 0])
    return figure


def names_and_words_beside() -> Figure:
    figure, axes = style.panels(2, 4.0, sharex=False, height_ratios=(3, 2))
    for ax in axes:
        ax.set_yticks([0, 1], ["invariant EKF,\nvector biases", "tuned"])
        ax.set(xlabel="Cost [-]", xlim=(0, 1000))
        end = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
        ax.annotate("-95.07 [-112.34, -77.79]", (1, 0), (6, 0), size=style.TICK_SIZE, **end)
    axes[0].set_title("A title\nof two lines")
    return figure


def scale_of_colours() -> Figure:
    figure, (ax,) = style.panels(1, 3.0)
    drawn = ax.pcolormesh(1e3 * np.arange(12.0).reshape(3, 4))
    style.colour_bar(figure, drawn, ax, "Gain $K$ [1/s]")
    ax.set(xlabel="Scaled error [-]", ylabel="Scaled rate [-]")
    return figure


@pytest.mark.parametrize("draw", [numbers_of_all_sizes, names_and_words_beside, scale_of_colours])
def test_words_have_room_and_panels_most_of_it(draw) -> None:
    figure = style.styled(draw)()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer, whole = canvas.get_renderer(), figure.bbox
    boxes = [ax.get_tightbbox(renderer) for ax in figure.axes]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    for box in boxes:
        assert whole.x0 <= box.x0 < box.x1 <= whole.x1
        assert whole.y0 <= box.y0 < box.y1 <= whole.y1
    for a, b in combinations(boxes, 2):
        assert min(a.x1, b.x1) <= max(a.x0, b.x0) or min(a.y1, b.y1) <= max(a.y0, b.y0)
    panels = sum(ax.bbox.width * ax.bbox.height for ax in figure.axes)
    assert panels > 0.2 * whole.width * whole.height


def test_a_figure_too_small_for_its_words_stays_as_it_is() -> None:
    figure = style.styled(names_and_words_beside)()
    figure.set_size_inches(1, 1)
    before = [ax.get_position().bounds for ax in figure.axes]
    Room().execute(figure)
    assert [ax.get_position().bounds for ax in figure.axes] == before


def test_a_picture_is_drawn_once(monkeypatch) -> None:
    figure, drawn = style.styled(scale_of_colours)(), []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda *given: drawn.append(draw(*given)))
    assert style.png(figure).startswith(b"\x89PNG")
    assert len(drawn) == 1
    assert figure.get_layout_engine() is not None
