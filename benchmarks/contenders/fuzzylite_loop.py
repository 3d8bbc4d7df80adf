"""The plain loop with pyfuzzylite, whose terms are NumPy-vectorised over the sample points.

Run as a script by a Python that has pyfuzzylite and NumPy: `fuzzylite_loop.py SCENE.npz SECONDS`
prints JSON. That Python needs neither posegsa nor JAX.
"""

import json
import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent.parent))

import fuzzylite as fl  # pyright: ignore[reportMissingImports] - of its own environment
import numpy as np

from contenders.plain_loop import Controller, measure
from contenders.scene import RULES, load

_TERMS = ("VS", "S", "M", "L", "VL")


def controller(inputs: np.ndarray, outputs: np.ndarray, points: int) -> Controller:
    """A Mamdani engine on this number of sample points."""

    def terms(triangles: np.ndarray) -> list[fl.Term]:
        return [
            fl.Triangle(name, *map(float, abc)) for name, abc in zip(_TERMS, triangles, strict=True)
        ]

    output = fl.OutputVariable(
        "gain",
        minimum=0.0,
        maximum=100.0,
        aggregation=fl.Maximum(),
        defuzzifier=fl.Centroid(points),
        terms=terms(outputs),
    )
    rules = [
        fl.Rule.create(f"if rate is {_TERMS[i]} and error is {_TERMS[j]} then gain is {_TERMS[t]}")
        for i, row in enumerate(RULES)
        for j, t in enumerate(row)
    ]
    error, rate = (
        fl.InputVariable(name, minimum=0.0, maximum=1.0, terms=terms(inputs))
        for name in ("error", "rate")
    )
    engine = fl.Engine(
        input_variables=[error, rate],
        output_variables=[output],
        rule_blocks=[
            fl.RuleBlock(
                conjunction=fl.Minimum(),
                implication=fl.Minimum(),
                activation=fl.General(),
                rules=rules,
            )
        ],
    )

    def gain(e: float, r: float, last: float) -> float:
        error.value, rate.value = e, r
        engine.process()
        value = float(np.squeeze(output.value))
        return last if np.isnan(value) else 1 + value

    return gain


if __name__ == "__main__":
    print(json.dumps(measure(load(Path(sys.argv[1])), controller, float(sys.argv[2]))))
