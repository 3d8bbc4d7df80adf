"""The common input of all contenders: scenarios and fuzzy terms as plain arrays (NumPy only).

Made by posegsa (`posegsa_worker.py`), so that noise and parameters are the same for all; read
without it, so that a contender may live in an environment of its own.
"""

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

RULES = (
    (0, 1, 2, 4, 4),
    (1, 2, 2, 4, 4),
    (2, 2, 3, 4, 4),
    (2, 3, 4, 4, 4),
    (3, 3, 4, 4, 4),
)
"""The paper's Table I from VS to VL: rows are the rate, columns the error, entries output terms."""


@dataclass(frozen=True)
class Scene:
    """S scenarios of N samples, A agents; the gradient law with one step per sample."""

    time_step: np.ndarray
    """(S, N) [s]."""
    angular_velocity: np.ndarray
    """(S, N, 3) measured, body frame [rad/s]."""
    velocity: np.ndarray
    """(S, N, 3) measured, body frame [m/s]."""
    profile: np.ndarray
    """(S, N, 3, 3) B = sum_i s_i v_i^B (v_i^I)^T over the vectors."""
    vector_power: np.ndarray
    """(S, N) sum_i s_i (|v_i^B|^2 + |v_i^I|^2)."""
    vector_curvature: np.ndarray
    """(S, N) 1/2 sum_i s_i |v_i^B| |v_i^I|."""
    attitude_scale: np.ndarray
    """(S, N) 3 / (8 sum_i s_i)."""
    landmark_body: np.ndarray
    """(S, N, 3) y, the one landmark as measured [m]."""
    landmark_inertial: np.ndarray
    """(S, N, 3) p, its position [m]."""
    landmark_weight: np.ndarray
    """(S, N) its weight s."""
    true_attitude: np.ndarray
    """(S, N, 4) unit quaternion of R, w first."""
    true_origin: np.ndarray
    """(S, N, 3) R^T P [m]."""
    attitude: np.ndarray
    """(S, 4) first estimate, unit quaternion."""
    position: np.ndarray
    """(S, 3) first estimate [m]."""
    bias: np.ndarray
    """(S, 6) first estimate [rad/s, m/s]."""
    cost_weight: np.ndarray
    """(N,) weight of each sample's error in the cost."""
    cost_position: float
    """Weight of the position error in the cost [1/m]."""
    gamma: np.ndarray
    """(2,) gains of the bias law, angular and linear [1/s^2]."""
    gain_limit: float
    """c; 0 for no limit."""
    position_weight: float
    """Position weight of the error signal [1/m]."""
    smoothing: float
    """Smoothing time of the error signal [s]."""
    error_scale: float
    rate_scale: float
    initial_gain: float
    """Gain before any rule has fired [1/s]."""
    inputs: np.ndarray
    """(A, 5, 3) input terms: left foot, peak, right foot."""
    outputs: np.ndarray
    """(A, 5, 3) output terms [1/s]."""

    @property
    def scenarios(self) -> int:
        """S."""
        return self.time_step.shape[0]

    @property
    def samples(self) -> int:
        """N."""
        return self.time_step.shape[1]

    @property
    def agents(self) -> int:
        """A."""
        return self.inputs.shape[0]

    @property
    def smoothing_factor(self) -> np.ndarray:
        """(S, N) weight of the last signal in the present one (backward Euler)."""
        before = np.roll(self.time_step, 1, axis=1)
        return self.smoothing / (self.smoothing + before)

    def part(self, start: int, samples: int, agents: int | None = None) -> "Scene":
        """Samples from `start` on, of the first agents, started at the true pose.

        Far from the truth the gain limit decides the gain, and costs do not depend on the fuzzy
        controller; from the truth on, they do.
        """
        kept = {name: getattr(self, name)[:agents] for name in ("inputs", "outputs")}
        chosen, whole = slice(start, start + samples), self.samples
        for field in fields(self):
            value = getattr(self, field.name)
            if np.ndim(value) >= 2 and np.shape(value)[1] == whole and field.name not in kept:
                kept[field.name] = value[:, chosen]
        w, v = self.true_attitude[:, start, :1], self.true_attitude[:, start, 1:]
        origin = self.true_origin[:, start]
        turned = 2 * np.cross(v, origin)
        return replace(
            self,
            cost_weight=self.cost_weight[chosen],
            attitude=self.true_attitude[:, start],
            position=origin + w * turned + np.cross(v, turned),
            **kept,
        )

    def first(self, samples: int) -> "Scene":
        """The first samples, from the initial estimate."""
        first = self.part(0, samples)
        return replace(first, attitude=self.attitude, position=self.position)

    def save(self, path: Path) -> None:
        """Write it as .npz."""
        np.savez(path, **asdict(self))


def load(path: Path) -> Scene:
    """Read what `Scene.save` wrote."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    values: dict[str, Any] = {name: a if a.ndim else float(a) for name, a in arrays.items()}
    return Scene(**values)
