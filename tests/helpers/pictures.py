"""What figures are made of in tests, and what they show."""

import numpy as np

from posegsa.judging.trajectory import Trajectory
from posegsa.optimisers import History


def history(iterations=40, non_finite=0):
    cost = 40 + 20 / np.arange(1.0, iterations + 1)
    return History(cost, cost + 5, cost + 9, np.full(iterations, non_finite))


def trajectory(samples=301, **values):
    rng = np.random.default_rng(0)
    shapes = {"euler": 3, "euler_est": 3, "position": 3, "position_est": 3, "bias_est": 6}
    shapes |= {"vector_bias_est": 6, "vector_bias_error": 2}
    names = Trajectory.__dataclass_fields__
    drawn = {
        n: rng.uniform(0.1, 80, (samples, shapes[n]) if n in shapes else samples) for n in names
    }
    return Trajectory(**{**drawn, "time": 0.01 * np.arange(samples), **values})


def lines(ax):
    return [(np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in ax.lines]


def legend(figure):
    return [text.get_text() for found in figure.legends for text in found.get_texts()]
