"""Independent NumPy float64 reference of the whole chain, the oracle of the test suite.

Written only from the paper's equations and the conventions below, with matrices and loops, for
readability, not speed; it shares no code with the package and must stay that way.  Equation
numbers are the paper's.

Conventions: inertial frame I, body frame B; T = [[R, P], [0, 1]] maps B to I, P is in
I.  Tangent vectors are xi = [omega; v], rotation first.  SI units, radians.  R_err = R_est R^T,
P_err = P_est - R_err P.  Time-major arrays.  A measurement of weight 0 may hold NaN.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product
from typing import Any, Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]
Signal = Literal["measured", "pose"]
Rate = Literal["per_sample", "per_second"]
GammaLaw = Literal["fixed", "linear", "quadratic"]

# Table I: [row of the rate, column of the error] -> output term, all ascending: 0 = VS, 1 = S,
# 2 = M, 3 = L, 4 = VL.  The paper prints both axes from VL down to VS and writes L as "V".
PAPER_RULES: NDArray[np.int64] = np.array(
    [
        [0, 1, 2, 4, 4],  # rate VS
        [1, 2, 2, 4, 4],  # rate S
        [2, 2, 3, 4, 4],  # rate M
        [2, 3, 4, 4, 4],  # rate L
        [3, 3, 4, 4, 4],  # rate VL
    ]
)
# Eqs. 18 and 19: the box of k1..k22; the last 11 numbers are gains.
PAPER_LOWER: Array = np.append(
    [0, 0, 0, 0.1, 0.05, 0.1, 0.1, 0.1, 0.2, 0.3, 0.2], [0, 0, 0, 5, 5, 10, 20, 20, 20, 40, 30]
)
PAPER_UPPER: Array = np.append(
    [0.15, 0.2, 0.2, 0.2, 0.2, 0.3, 0.4, 0.4, 0.8, 0.8, 0.7],
    [10, 10, 20, 30, 20, 50, 50, 50, 70, 90, 70],
)


@dataclass(frozen=True)
class Sample:
    """Everything measured at one instant t_k, and the time dt (s) to the next one."""

    dt: float
    omega: Array  # (3,) measured angular velocity in B, rad/s (Eq. 6)
    v: Array  # (3,) measured translational velocity in B, m/s (Eq. 6)
    y: Array  # (L, 3) measured landmarks in B, m (Eq. 4)
    p: Array  # (L, 3) known landmarks in I, m
    sL: Array  # (L,) landmark weights, 0: not measured
    vB: Array  # (n, 3) measured vectors in B, as measured (Eq. 2) or as used (`used_vectors`)
    vI: Array  # (n, 3) known vectors in I, raw or as used
    sR: Array  # (n,) vector weights, 0: not measured


@dataclass(frozen=True)
class VectorBias:
    """The numbers of the law that estimates the vectors' biases."""

    gain: float  # gamma_c, 1/s
    leak: float  # rate at which an estimate decays, 1/s
    bound: float  # largest length of an estimate, in the vector's unit
    excitation: float  # w_0, angular velocity above which the full gain is used, rad/s
    excitation_time: float  # time constant of the low-pass filter of the angular velocity, s
    law: GammaLaw = "fixed"  # how gamma_c follows the gain


@dataclass(frozen=True)
class Trajectory:
    """The records of `run` at each sample, before that sample's update."""

    T_est: Array  # (N, 4, 4) pose estimate
    b_est: Array  # (N, 6) estimated velocity bias, rad/s and m/s
    c_est: Array  # (N, n, 3) estimated bias of each vector, in its unit
    gain: Array  # (N,) requested K, before any gain limit
    e: Array  # (N,) error signal, smoothed, neither scaled nor clipped
    rate: Array  # (N,) its change since the sample before, neither scaled nor clipped
    unknown: Array  # (N,) unknown share of the biases, lower limit of the scaled error
    attitude_error: Array  # (N,) ||R_err||_I, in [0, 1]
    position_error: Array  # (N,) |P_err|, m


def skew(x: Array) -> Array:
    """[x]_x, (3, 3), with [x]_x y = x cross y, of x (3,)."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def wedge(xi: Array) -> Array:
    """[xi]_^, (4, 4), of xi = [omega; v] (6,)."""
    return np.block([[skew(xi[:3]), xi[3:, None]], [np.zeros((1, 4))]])


def se3_exp(xi: Array) -> Array:
    """Exponential of xi (6,) as a pose (4, 4), by a general matrix exponential."""
    return np.asarray(scipy.linalg.expm(wedge(xi)), dtype=np.float64)


def adjoint(T: Array) -> Array:
    """Ad(T) = [[R, 0], [[P]_x R, R]], (6, 6): takes a body tangent vector to the spatial one."""
    R, P = T[:3, :3], T[:3, 3]
    return np.block([[R, np.zeros((3, 3))], [skew(P) @ R, R]])


def wedge_product(x4: Array, y4: Array) -> Array:
    """The paper's [x; x0] ^ [y; y0] = [x cross y; x0 y - y0 x], (6,), of two (4,) vectors."""
    x, x0, y, y0 = x4[:3], x4[3], y4[:3], y4[3]
    return np.concatenate([np.cross(x, y), x0 * y - y0 * x])


def integrate_truth(omega: Array, v: Array, dt: Array, T0: Array) -> Array:
    """Poses (N, 4, 4) at t_k from true body velocities (N, 3) and dt (N,) in s (Eq. 5)."""
    poses = [T0]
    for k in range(len(dt) - 1):
        poses.append(poses[k] @ se3_exp(np.concatenate([omega[k], v[k]]) * dt[k]))
    return np.array(poses)


def attitude_distance(R_err: Array) -> float:
    """||R_err||_I = (1/4) tr(I - R_err), in [0, 1], of R_err (3, 3)."""
    return float(np.trace(np.eye(3) - R_err) / 4.0)


def innovation(
    T_est: Array, y: Array, p: Array, sL: Array, vB: Array, vI: Array, sR: Array
) -> Array:
    """U (6,) of Eq. 9, in I: the sums over landmarks and over vectors, each halved.

    y, p (L, 3), m; sL (L,); vB, vI (n, 3); sR (n,).  Entries of weight 0 are ignored.
    """
    U = np.zeros(6)
    for i in np.flatnonzero(sL):
        U += 0.5 * sL[i] * wedge_product(T_est @ np.append(y[i], 1.0), np.append(p[i], 1.0))
    for i in np.flatnonzero(sR):
        U += 0.5 * sR[i] * wedge_product(T_est @ np.append(vB[i], 0.0), np.append(vI[i], 0.0))
    return U


def curvature(
    T_est: Array,
    y: Array,
    p: Array,
    sL: Array,
    vB: Array,
    vI: Array,
    sR: Array,
    square_length: float = 1.0,
) -> float:
    """L with x_i = T_est y_i, in a unit of length of which this is the square, m^2.

    A step is stable if K dt L < 2.
    """
    total = 0.0
    for i in np.flatnonzero(sR):
        total += 0.5 * sR[i] * np.linalg.norm(vB[i]) * np.linalg.norm(vI[i])
    for i in np.flatnonzero(sL):
        x = np.linalg.norm((T_est @ np.append(y[i], 1.0))[:3])
        q = np.linalg.norm(p[i])
        l2 = square_length
        total += 0.25 * sL[i] * (l2 + x * q + np.sqrt((l2 + x**2) * (l2 + q**2)))
    return float(total)


def used_sample(
    sample: Sample,
    c_est: Array,
    *,
    normalise: bool = False,
    cross_weight: float | None = None,
    vector_weights: Sequence[float] | None = None,
    landmark_weights: Sequence[float] | None = None,
) -> Sample:
    """A sample whose vectors and weights are those that U and the error signal use.

    Each measured vector less its estimated bias c_est (n, 3); then the cross product of the first
    two with the weight cross_weight, missing where one of them is (None: without it); then all
    brought to length 1 (Eq. 3). The filter's weights (None: all 1) multiply the sample's.
    """
    u = [v - c for v, c in zip(sample.vB, c_est, strict=True)]
    v, s = list(sample.vI), list(sample.sR * (1.0 if vector_weights is None else vector_weights))
    if cross_weight is not None:
        u.append(np.cross(u[0], u[1]))
        v.append(np.cross(v[0], v[1]))
        s.append(cross_weight * min(sample.sR[0], sample.sR[1]))
    if normalise:
        u, v = ([a / np.linalg.norm(a) for a in vectors] for vectors in (u, v))
    u, v = (np.reshape(np.array(vectors, np.float64), (-1, 3)) for vectors in (u, v))
    sL = sample.sL * (1.0 if landmark_weights is None else landmark_weights)
    return replace(sample, vB=u, vI=v, sR=np.array(s, np.float64), sL=np.array(sL, np.float64))


def learn_vector_biases(
    T_est: Array,
    b_est: Array,
    c_est: Array,
    turning: Array,
    sample: Sample,
    learning: float,
    law: VectorBias,
    used: float,
) -> tuple[Array, Array]:
    """Vectors' biases (n, 3), and low-passed angular velocity (3,), at t_{k+1} from those at t_k.

    dc/dt = gamma_c (v^B - c - R_est^T v^I) - leak c, by one step of Euler's; gamma_c is multiplied
    by learning, by 1, K_used / 10 or its square, and by min(1, (|w| / w_0)^4), w the low-passed
    measured angular velocity (backward Euler) less its estimated bias; the step is 1 at most. The
    biases of missing vectors do not change. A bias that is longer than the bound by a factor x is
    multiplied by max(0, (3 - x^2) / 2).
    """
    dt, R = sample.dt, T_est[:3, :3]
    turning = (law.excitation_time * turning + dt * sample.omega) / (law.excitation_time + dt)
    w = np.linalg.norm(turning - b_est[:3])
    power = {"fixed": 0, "linear": 1, "quadratic": 2}[law.law]
    follow = (used / 10.0) ** power
    share = learning * law.gain * follow * min(1.0, float(w / law.excitation) ** 4)
    share = min(share, 1.0 / dt)
    c_new = c_est.copy()
    for i in np.flatnonzero(sample.sR):
        residual = sample.vB[i] - c_est[i] - R.T @ sample.vI[i]
        c_new[i] = c_est[i] + dt * (share * residual - law.leak * c_est[i])
    return np.array([within(c, law.bound) for c in c_new]).reshape(c_new.shape), turning


def within(b: Array, bound: float) -> Array:
    """A bias, multiplied by max(0, (3 - x^2) / 2) if it is x > 1 times as long as its bound."""
    x = np.linalg.norm(b) / bound
    return b * max(0.0, (3 - x**2) / 2) if x > 1 else b


def filter_step(
    T_est: Array,
    b_est: Array,
    sample: Sample,
    gain: float,
    *,
    law: Literal["gradient", "printed"] = "gradient",
    gamma: tuple[float, float] = (5.0, 5.0),
    gamma_law: GammaLaw = "fixed",
    substeps: int = 1,
    gain_limit: float | None = None,
    length: float = 1.0,
    length_growth: float = 0.0,
    landmark_unit: Literal["metre", "length"] = "metre",
    share: float = 1.0,
    bias_bounds: tuple[float, float] | None = None,
    gains_used: list[float] | None = None,
) -> tuple[Array, Array]:
    """Estimate (4, 4) and bias (6,) at t_{k+1} from those at t_k (Eq. 9).

    gamma is the bias gain of (omega, v), with the laws "linear" and "quadratic" times K_used / 10
    and its square; there gamma dt is at most K_used / 2 of v, and K_used / 2 / (1 + |y|^2) of
    omega, y the farthest landmark. Lengths are in units of l, with l^2 = length^2 + length_growth
    |y|^2; the weights of landmarks are per m^2 or per l^2: the linear part of U in W, and the bias
    law of v, are multiplied by l^2, each 1 that is added to a squared length in L is l^2, and |y|^2
    is divided by it. share multiplies both gammas last. gain_limit is c of K_used = min(K, c /
    (dt/n L)). bias_bounds are the largest lengths of the biases of omega and v. Each of the n inner
    steps evaluates everything at its own start, with the same measurement; the velocity (Y_m -
    b_est) dt enters only with the last one. The sample's vectors are those that are used.
    """
    s, h = sample, sample.dt / substeps
    squares = [float(y @ y) for y, w in zip(s.y, s.sL, strict=True) if w > 0]
    farthest = max(squares, default=0.0)
    l2 = length**2 + length_growth * farthest
    sL = s.sL / l2 if landmark_unit == "length" else s.sL
    measured = (s.y, s.p, sL, s.vB, s.vI, s.sR)
    metric = np.diag([1.0, 1.0, 1.0, l2, l2, l2])
    for inner in range(substeps):
        U = innovation(T_est, *measured)
        inverse, transpose = np.linalg.inv(adjoint(T_est)), adjoint(T_est).T
        for_W, for_b = {
            "gradient": (inverse @ metric, metric @ transpose),
            "printed": (transpose, inverse),
        }[law]
        W = for_W @ U
        K_used, hL = gain, h * curvature(T_est, *measured, l2)
        if gain_limit is not None and hL > 0:
            K_used = min(gain, gain_limit / hL)
        if gains_used is not None:
            gains_used.append(K_used)
        g = np.repeat(np.array(gamma, np.float64), 3)
        if gamma_law != "fixed":
            power = {"linear": 1, "quadratic": 2}[gamma_law]
            g = g * (K_used / 10.0) ** power
            g[:3] = np.minimum(g[:3], K_used / (2 * s.dt * (1 + farthest / l2)))
            g[3:] = np.minimum(g[3:], K_used / (2 * s.dt))
        b_dot = -share * g * (for_b @ U)
        move = K_used * W * h
        if inner == substeps - 1:
            move = move + (np.concatenate([s.omega, s.v]) - b_est) * s.dt
        T_est = T_est @ se3_exp(move)
        b_est = b_est + b_dot * h
        if bias_bounds is not None:
            b_est = np.concatenate(
                [within(b, m) for b, m in zip(np.split(b_est, 2), bias_bounds, strict=True)]
            )
    return T_est, b_est


def pose_errors(T_est: Array, T_true: Array) -> tuple[float, float]:
    """(||R_err||_I, |P_err| in m), Eq. 8: R_err = R_est R^T, P_err = P_est - R_err P."""
    R_err = T_est[:3, :3] @ T_true[:3, :3].T
    P_err = T_est[:3, 3] - R_err @ T_true[:3, 3]
    return attitude_distance(R_err), float(np.linalg.norm(P_err))


def measured_errors(T_est: Array, sample: Sample) -> tuple[float | None, float | None]:
    """Attitude and position part of the measured error signal; None if nothing is measured.

    3/(8 sum s^R) sum s^R |R_est u - v^I|^2 of the vectors that are used, and the weighted mean of
    |T_est y - p|.
    """
    s, R_est, P_est = sample, T_est[:3, :3], T_est[:3, 3]
    attitude = position = None
    if np.any(s.sR > 0):
        attitude = 0.0
        for i in np.flatnonzero(s.sR):
            squared = np.sum((R_est @ s.vB[i] - s.vI[i]) ** 2)
            attitude += float(3.0 / (8.0 * np.sum(s.sR)) * s.sR[i] * squared)
    if np.any(s.sL > 0):
        position = 0.0
        for i in np.flatnonzero(s.sL):
            distance = np.linalg.norm(R_est @ s.y[i] + P_est - s.p[i])
            position += float(s.sL[i] * distance / np.sum(s.sL))
    return attitude, position


def triangle(x: float, a: float, b: float, c: float) -> float:
    """Membership of x in the triangle a <= b <= c; a vertical edge belongs to the term."""
    if x < a or x > c:
        return 0.0
    if x == b:
        return 1.0
    return (x - a) / (b - a) if x < b else (c - x) / (c - b)


def firing_heights(e: float, rate: float, input_terms: Array, rules: NDArray[np.int64]) -> Array:
    """Height (5,) of each output term: min over a rule's two inputs, max over its rules.

    input_terms (5, 3) serve both inputs; rules (5, 5) are [rate term, error term] -> output term.
    """
    heights = np.zeros(5)
    for (row, column), output in np.ndenumerate(rules):
        fired = min(triangle(rate, *input_terms[row]), triangle(e, *input_terms[column]))
        heights[output] = max(heights[output], fired)
    return heights


def aggregated(z: float, heights: Array, output_terms: Array) -> float:
    """max_i min(h_i, triangle_i(z)), the membership of z in the clipped and joined outputs."""
    clipped = [min(h, triangle(z, *t)) for h, t in zip(heights, output_terms, strict=True)]
    return float(max(clipped))


def centroid_by_quadrature(heights: Array, output_terms: Array) -> float:
    """Exact centroid of max_i min(h_i, triangle_i(z)) for heights (n,), terms (n, 3); nan: no area.

    An edge is z = foot + run * y at membership y, vertical if run = 0.  The joined membership is
    linear between all vertices, clip points and crossings of edges, so a two-point Gauss rule
    integrates mu and z mu exactly; a piece too narrow to hold its nodes inside is skipped.
    """
    heights, output_terms = heights[heights > 0], output_terms[heights > 0]
    edges = [edge for a, b, c in output_terms for edge in ((a, b - a), (c, b - c))]
    points = [float(z) for z in np.ravel(output_terms)]
    points += [float(foot + run * h) for foot, run in edges for h in heights]
    for (foot1, run1), (foot2, run2) in combinations(edges, 2):
        if run1 != run2 and 0.0 <= (foot2 - foot1) / (run1 - run2) <= 1.0:
            points.append(float(foot1 + run1 * (foot2 - foot1) / (run1 - run2)))
    area = moment = 0.0
    for left, right in pairwise(sorted(set(points))):
        middle, half = (left + right) / 2.0, (right - left) / 2.0
        for z in (middle - half / np.sqrt(3.0), middle + half / np.sqrt(3.0)):
            mu = aggregated(z, heights, output_terms) if left < z < right else 0.0
            area += half * mu
            moment += half * mu * z
    return float(moment / area) if area > 0 else float("nan")


def sampled_centroid(
    heights: Array, output_terms: Array, lower: float, upper: float, points: int
) -> float:
    """sum z mu / sum mu over equidistant points including both ends; nan where sum mu is 0."""
    grid = np.linspace(lower, upper, points)
    mu = np.array([aggregated(z, heights, output_terms) for z in grid])
    return float(np.sum(grid * mu) / np.sum(mu)) if np.sum(mu) > 0 else float("nan")


def fuzzy_gain(
    e: float,
    rate: float,
    input_terms: Array,
    output_terms: Array,
    rules: NDArray[np.int64],
    last: float,
    *,
    centroid: Callable[[Array, Array], float] = centroid_by_quadrature,
    no_rule: Literal["hold", "midrange"] = "hold",
    lower: float = 0.0,
    upper: float = 100.0,
) -> float:
    """K = 1 + centroid of e and rate, both scaled and clipped already; never nan.

    `last` is the gain of the sample before; [lower, upper] is the output universe.  Where rules
    fire without area the limit point is the firing term's peak; several such terms at different
    places have no unique limit, and the peaks' mean by height is a choice made here.
    """
    heights = firing_heights(e, rate, input_terms, rules)
    if not np.any(heights > 0):
        return last if no_rule == "hold" else 1.0 + (lower + upper) / 2.0
    k_op = centroid(heights, output_terms)
    if np.isnan(k_op):
        k_op = float(np.sum(heights * output_terms[:, 1]) / np.sum(heights))
    return 1.0 + k_op


def terms_of(k: Array) -> tuple[Array, Array]:
    """Input and output terms, (5, 3) each, of k1..k22 as Eqs. 18 and 19 place them, unrepaired."""
    inputs = np.concatenate([[0, 0, k[0]], k[1:4], k[4:7], k[7:10], [k[10], 1, 1]])
    outputs = np.concatenate([[0, 0, k[11]], k[12:15], k[15:18], k[18:21], [k[21], 100, 100]])
    return inputs.reshape(5, 3), outputs.reshape(5, 3)


def repair(
    k: Array,
    lower: Array,
    upper: Array,
    ordering: bool = True,
    coverage: bool = True,
    overlap: float = 0.01,
) -> tuple[Array, Array]:
    """Terms (5, 3), (5, 3) of k (22,) inside the box [lower, upper], repaired."""
    for bounds in (*terms_of(lower), *terms_of(upper)):
        if np.any(np.diff(bounds, axis=0) < 0) or np.any(np.diff(bounds, axis=1) < 0):
            raise ValueError("the bounds must ascend within each term and from term to term")
    inputs, outputs = terms_of(k)
    if ordering:
        for terms in (inputs, outputs):
            terms.sort(axis=1)  # each triangle: a <= b <= c
            terms.sort(axis=0)  # then the a's, the b's and the c's across terms
    if coverage:
        low = terms_of(lower)[0][:, 0]
        for i in range(4):
            reach = min(inputs[i + 1, 0], inputs[i, 2] - overlap)
            inputs[i + 1, 0] = max(low[i + 1], inputs[i, 0], reach)
    return inputs, outputs


def run(
    samples: Sequence[Sample],
    T0_est: Array,
    b0_est: Array,
    T_true: Array,
    gain_function: Callable[[float, float, float], float],
    *,
    signal: Signal = "measured",
    position_weight: float = 0.2,
    smoothing: float = 0.0,
    error_scale: float = 1.0,
    rate: Rate = "per_sample",
    rate_scale: float = 1.0,
    lower: float = 0.0,
    upper: float = 100.0,
    vector_bias: VectorBias | None = None,
    learning: Callable[[float], float] = lambda time: 1.0,
    unknown: tuple[float, float, float] | None = None,
    bias_wait: float | None = None,
    as_used: dict[str, Any] | None = None,
    **step_options: Any,
) -> Trajectory:
    """The loop of gain and filter over N samples; T_true is (N, 4, 4).

    The error signal e is attitude + position_weight * position, each part at its last value (0
    before the first) where it is not measured, passed through a low-pass filter (backward Euler,
    time constant `smoothing` in s) that starts at its first value.  "pose": of true errors.
    gain_function(error, rate, last gain) -> K sees e / error_scale and |e_k - e_{k-1}| rate_scale,
    "per_second" over the time between the two, each clipped to [0, 1], the rate 0 at sample 0.  The
    last gain is the K requested at the sample before, 1 + (lower + upper) / 2 at sample 0.
    learning(time) is the factor on vector_bias' gain.  unknown (start, fall, rise): the error that
    gain_function sees is at least u, which begins at start, is at least rise times the scaled and
    clipped error, and is divided by 1 + fall K_used dt share m after each sample, m = 1/2 for
    measured vectors + 1/2 for measured landmarks.  share = 1 / (1 + (z / bias_wait)^4), z the error
    signal before the low-pass filter, multiplies the gains of all bias laws.  as_used goes to
    `used_sample`, step_options to `filter_step`.
    """
    T_est, b_est, last = T0_est, b0_est, 1.0 + (lower + upper) / 2.0
    c_est, turning, time = np.zeros_like(samples[0].vI), np.zeros(3), 0.0
    parts, e, rows = [0.0, 0.0], 0.0, []
    u, fall, rise = unknown or (0.0, 0.0, 0.0)
    for k, sample in enumerate(samples):
        used = used_sample(sample, c_est, **as_used or {})
        true = pose_errors(T_est, T_true[k])
        measured = true if signal == "pose" else measured_errors(T_est, used)
        parts = [old if new is None else new for old, new in zip(parts, measured, strict=True)]
        before, e, change = e, parts[0] + position_weight * parts[1], 0.0
        share = 1.0 if bias_wait is None else 1 / (1 + (e / bias_wait) ** 4)
        if k > 0:
            passed = samples[k - 1].dt
            e = (passed * e + smoothing * before) / (passed + smoothing)
            change = abs(e - before) / (passed if rate == "per_second" else 1.0)
        seen = np.clip([e / error_scale, change * rate_scale], 0.0, 1.0)
        u = max(u, rise * float(seen[0]))
        last = gain_function(max(float(seen[0]), u), float(seen[1]), last)
        rows.append((T_est, b_est, c_est, last, e, change, u, *true))
        gains: list[float] = []
        stepped = filter_step(
            T_est, b_est, used, last, share=share, gains_used=gains, **step_options
        )
        measures = 0.5 * np.any(used.sR > 0) + 0.5 * np.any(used.sL > 0)
        u /= 1 + fall * float(np.mean(gains)) * sample.dt * share * float(measures)
        if vector_bias is not None:
            c_est, turning = learn_vector_biases(
                T_est,
                b_est,
                c_est,
                turning,
                sample,
                learning(time) * share,
                vector_bias,
                float(np.mean(gains)),
            )
        (T_est, b_est), time = stepped, time + sample.dt
    return Trajectory(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def cost(
    attitude_error: Array,
    position_error: Array,
    *,
    transient_weight: float = 0.3,
    position_weight: float = 0.2,
    transient: tuple[int, int] = (0, 100),
    steady: tuple[int, int] = (400, 1400),
) -> float:
    """Eq. 17 over sample indices, both ends of each window included."""
    total = 0.0
    for weight, (first, final) in ((transient_weight, transient), (1.0, steady)):
        for k in range(first, final + 1):
            total += weight * (attitude_error[k] + position_weight * position_error[k])
    return float(total)


def gsa_masses(costs: Array) -> Array:
    """Masses M (N,) that sum to 1 (Eqs. 12, 13) of finite costs (N,), the smallest the best."""
    best, worst = min(costs), max(costs)
    if best == worst:
        return np.full(len(costs), 1.0 / len(costs))
    m = np.array([(fit - worst) / (best - worst) for fit in costs])
    return m / m.sum()


def gsa_acceleration(
    x: Array, costs: Array, G: float, k_best: int, rand: Array, power: float, eps: float
) -> Array:
    """a_i = G sum_{j in K_best, j != i} rand_ijd M_j (x_j - x_i) / (R_ij^p + eps).

    x, a (N, D), costs (N,), rand (N, N, D); R_ij = |x_j - x_i|; K_best: least cost, ties by index.
    """
    M = gsa_masses(costs)
    heaviest = sorted(range(len(costs)), key=lambda j: costs[j])[:k_best]
    a = np.zeros_like(x)
    for i, j in product(range(len(x)), heaviest):
        if j != i:
            distance = float(np.linalg.norm(x[j] - x[i]))
            a[i] += G * rand[i, j] * M[j] * (x[j] - x[i]) / (distance**power + eps)
    return a
