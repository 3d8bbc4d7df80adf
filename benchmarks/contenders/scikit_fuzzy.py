"""The plain loop with scikit-fuzzy's controller (`skfuzzy.control`)."""

import warnings
from typing import Any

import numpy as np

from contenders.plain_loop import Controller, measure
from contenders.scene import RULES, Scene

_TERMS = ("VS", "S", "M", "L", "VL")


def controller(inputs: np.ndarray, outputs: np.ndarray, points: int) -> Controller:
    """A controller as scikit-fuzzy's own examples build one, with `points` sample points."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it uses deprecated parts of NumPy
        import skfuzzy
        from skfuzzy import control

    unit, gains = np.linspace(0, 1, points), np.linspace(0, 100, points)
    error, rate = control.Antecedent(unit, "error"), control.Antecedent(unit, "rate")
    output = control.Consequent(gains, "gain")
    for variable, terms in ((error, inputs), (rate, inputs), (output, outputs)):
        for name, abc in zip(_TERMS, terms, strict=True):
            variable[name] = skfuzzy.trimf(variable.universe, abc)
    rules = [
        control.Rule(rate[_TERMS[i]] & error[_TERMS[j]], output[_TERMS[target]])
        for i, row in enumerate(RULES)
        for j, target in enumerate(row)
    ]
    simulation = control.ControlSystemSimulation(control.ControlSystem(rules), cache=False)

    def gain(e: float, r: float, last: float) -> float:
        simulation.input["error"], simulation.input["rate"] = e, r
        simulation.compute()
        # Coarse universes can lose a narrow term, so that no rule fires.
        return 1 + float(simulation.output["gain"]) if "gain" in simulation.output else last

    return gain


def run(scene: Scene, seconds: float) -> dict[str, Any]:
    """See `plain_loop.measure`."""
    return measure(scene, controller, seconds)
