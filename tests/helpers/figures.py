"""The content of a figure."""

import numpy as np


def lines(ax):
    return [(np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in ax.lines]


def legend(figure):
    return [text.get_text() for found in figure.legends for text in found.get_texts()]
