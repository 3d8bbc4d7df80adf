"""WIP"""
import numpy as np
from contenders.scene import Scene

def scene_of(problem, controller) -> Scene:
    """A posegsa problem and its controllers (leaves (A, ...)) as plain arrays, in float64."""
    (landmark,) = problem.tracks.sample.landmarks
    sample, truth, state = problem.tracks.sample, problem.tracks.truth, problem.initial

    def stack(components) -> np.ndarray:
        return np.stack([np.asarray(a, np.float64) for a in components], axis=-1)

    def plain(a) -> np.ndarray:
        return np.asarray(a, np.float64)

    limit = problem.settings.gain_limit
    signal = problem.signal
    return Scene(
        time_step=plain(sample.time_step),
        angular_velocity=stack(sample.angular_velocity),
        velocity=stack(sample.velocity),
        profile=np.stack([stack(row) for row in sample.profile], axis=-2),
        vector_power=plain(sample.vector_power),
        vector_curvature=plain(sample.vector_curvature),
        attitude_scale=plain(sample.attitude_scale),
        landmark_body=stack(landmark.body),
        landmark_inertial=stack(landmark.inertial),
        landmark_weight=plain(landmark.weight),
        true_attitude=stack(truth.attitude),
        true_origin=stack(truth.origin),
        attitude=stack(state.attitude),
        position=stack(state.place),
        bias=stack(state.bias_angular + state.bias_linear),
        cost_weight=plain(problem.weights.transient) + plain(problem.weights.steady),
        cost_position=float(problem.weights.position),
        gamma=np.array([problem.settings.gamma_angular, problem.settings.gamma_linear], np.float64),
        gain_limit=0.0 if limit is None else float(limit),
        position_weight=float(signal.position_weight),
        smoothing=float(signal.smoothing),
        error_scale=float(signal.error_scale),
        rate_scale=float(signal.rate_scale),
        initial_gain=float(controller.initial_gain()),
        inputs=plain(controller.input_terms),
        outputs=plain(controller.output_terms),
    )
