"""The moving-horizon example of do-mpc's documentation: three masses on springs, an inertia and the speeds unknown.

    python -m benchmarks.oscillating_masses [--seeds N]

Equations, numbers, noise, horizon and weights are those of its "Getting started: MHE": angles are measured every 0.1 s
for 5 s with noise of 0.1 rad, inputs without; the start is wrong by half of each state (standard deviation). do-mpc and
the estimator in CasADi (Ipopt on the horizon's first state and the inertia, an extended Kalman filter's arrival cost)
take each sample; ours, which estimate no hidden state as it moves, judge roll-outs of the whole log once at its end,
with inertia and start as parameters. Errors are those of the inertia at the end; times are CPU times a sample, the
setting up included, for ours those of the one solve by the number of samples.
"""

import argparse
import importlib.util
from collections.abc import Callable, Sequence
from time import process_time
from typing import Any, Final

import numpy as np
import scipy.linalg

from benchmarks import report
from benchmarks.horizon_peers import imported_do_mpc
from cosim.blas_threads import one_thread
from cosim.objectives.choice import FunctionObjective
from estimator import METHODS, AskTell, EpisodeWindow, Objective, Parameter, ParameterSpace, Sample, Vector

C: Final = np.array([2.697, 2.66, 3.05, 2.86]) * 1e-3
D: Final = np.array([6.78, 8.01, 8.82]) * 1e-5
THETA: Final = 2.25e-4
"""Inertia of each mass; the first is sought."""
TAU, STEP, N, HORIZON, NOISE = 1e-2, 0.1, 50, 10, 0.1
START: Final = np.pi * np.array([1.0, 1.0, -1.5, 1.0, -5.0, 5.0, 0.0, 0.0])
GUESS: Final = 1e-4
SPACE: Final = ParameterSpace((
    Parameter("Theta_1", 1e-5, 1e-3, "kg.m2", "log"),
    *(Parameter(f"phi_{i}", -4.0 * np.pi, 4.0 * np.pi, "rad") for i in (1, 2, 3)),
    *(Parameter(f"dphi_{i}", -15.0 * np.pi, 15.0 * np.pi, "rad/s") for i in (1, 2, 3)),
))  # fmt: skip
OURS: Final = {"target": 90, "ukf": 200, "enkf": 200, "least-squares": 200}
"""Evaluations by name."""


def accelerations(phi: Any, dphi: Any, phi_m: Any, inertia: Any) -> list[Any]:
    """Return the angular accelerations of the three masses, of numbers or of symbols."""
    angles = [phi_m[0], phi[0], phi[1], phi[2], phi_m[1]]
    return [
        (C[i] * (angles[i] - angles[i + 1]) - C[i + 1] * (angles[i + 1] - angles[i + 2]) - D[i] * dphi[i])
        / (inertia if i == 0 else THETA)
        for i in range(3)
    ]


def transition(inertia: float) -> tuple[Vector, Vector]:
    """Return x and u to the next x, exactly: the system is linear, u is held."""
    A, B = np.zeros((8, 8)), np.zeros((8, 2))
    for j, x in enumerate(np.eye(8)):
        A[:, j] = [*x[3:6], *accelerations(x[:3], x[3:6], x[6:], inertia), *(-x[6:] / TAU)]
    B[6:] = np.eye(2) / TAU
    whole: Any = scipy.linalg.expm(STEP * np.block([[A, B], [np.zeros((2, 10))]]))
    return whole[:8, :8], whole[:8, 8:]


def rolled_out(inertia: float, x: Vector, inputs: Sequence[Vector]) -> Vector:
    """Return the angles (n, 3) after each input."""
    F, G = transition(inertia)
    angles: list[Vector] = []
    for u in inputs:
        x = F @ x + G @ u
        angles.append(x[:3])
    return np.array(angles)


def log_of(seed: int) -> tuple[Vector, Vector, Vector]:
    """Return inputs (n, 2), measured angles (n, 3) and a wrong start (8,)."""
    rng = np.random.default_rng(seed)
    u, inputs = np.zeros(2), list[Vector]()
    for _ in range(N):
        u = np.where(rng.random(2) >= 0.8, (0.5 - rng.random(2)) * np.pi, u)
        inputs.append(u)
    measured = rolled_out(THETA, START, inputs) + NOISE * rng.standard_normal((N, 3))
    return np.array(inputs), measured, START * (1.0 + 0.5 * rng.standard_normal(8))


def of_do_mpc(inputs: Vector, measured: Vector, start: Vector) -> float:
    """Return the inertia of do-mpc's estimator, set up as in its documentation."""
    import casadi

    do_mpc = imported_do_mpc()
    model = do_mpc.model.Model("continuous")
    phi, dphi, phi_m = (model.set_variable("_x", n, shape=(k, 1)) for n, k in (("phi", 3), ("dphi", 3), ("phi_m", 2)))
    wanted, inertia = model.set_variable("_u", "phi_m_set", shape=(2, 1)), model.set_variable("_p", "Theta_1")
    model.set_meas("phi_meas", phi, meas_noise=True)
    model.set_meas("phi_m_set_meas", wanted, meas_noise=False)
    model.set_rhs("phi", dphi)
    model.set_rhs("dphi", casadi.vertcat(*accelerations(phi, dphi, phi_m, inertia)))
    model.set_rhs("phi_m", (wanted - phi_m) / TAU)
    model.setup()
    mhe = do_mpc.estimator.MHE(model, ["Theta_1"])
    mhe.settings.t_step, mhe.settings.n_horizon, mhe.settings.meas_from_data = STEP, HORIZON, True
    mhe.settings.supress_ipopt_output()
    mhe.set_default_objective(P_x=np.eye(8), P_v=np.eye(3), P_p=10.0 * np.eye(1))
    mhe.set_p_fun(lambda _, given=mhe.get_p_template(): given)
    mhe.bounds["lower", "_u", "phi_m_set"], mhe.bounds["upper", "_u", "phi_m_set"] = -2.0 * np.pi, 2.0 * np.pi
    mhe.bounds["lower", "_p_est", "Theta_1"], mhe.bounds["upper", "_p_est", "Theta_1"] = 1e-5, 1e-3
    mhe.setup()
    mhe.x0, mhe.p_est0 = start, np.array([GUESS])
    mhe.set_initial_guess()
    for y, u in zip(measured, inputs, strict=True):
        mhe.make_step(np.concatenate([y, u])[:, None])
    return float(mhe.data["_p", "Theta_1"][-1, 0])


def of_casadi(inputs: Vector, measured: Vector, start: Vector) -> float:
    """Return the inertia of an estimator in CasADi: the horizon's first state and log(inertia) are sought."""
    import casadi

    z, u, y = casadi.SX.sym("z", 9), casadi.SX.sym("u", 2), casadi.SX.sym("y", 3)

    def slope(x: Any) -> Any:
        return casadi.vertcat(x[3:6], *accelerations(x[:3], x[3:6], x[6:8], casadi.exp(x[8])), (u - x[6:8]) / TAU, 0.0)

    x, h = z, STEP / 20
    for _ in range(20):
        k1 = slope(x)
        k2 = slope(x + h / 2 * k1)
        k3 = slope(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3))
    step = casadi.Function("step", [z, u], [x])
    taken = casadi.Function("taken", [z, u, y], [x, casadi.jacobian(x, z), (x[:3] - y) / NOISE])
    Z, mean, root, used = (
        casadi.MX.sym(n, *s) for n, s in (("z", (9,)), ("m", (9,)), ("L", (9, 9)), ("w", (HORIZON,)))
    )
    U, Y = casadi.MX.sym("U", 2, HORIZON), casadi.MX.sym("Y", 3, HORIZON)
    at, cost = Z, casadi.sumsqr(root @ (Z - mean))
    for k in range(HORIZON):
        at = step(at, U[:, k])
        cost += used[k] * casadi.sumsqr((at[:3] - Y[:, k]) / NOISE)
    given = casadi.vertcat(casadi.vec(U), casadi.vec(Y), used, mean, casadi.vec(root))
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    solver = casadi.nlpsol("mhe", "ipopt", {"x": Z, "p": given, "f": cost}, quiet)
    m, P = np.append(start, np.log(GUESS)), np.diag([*np.full(3, 4.0), *np.full(3, 64.0), 0.01, 0.01, 1.0])
    place, first = m, 0
    for k in range(1, len(inputs) + 1):
        if k - first > HORIZON:
            there, F, r = (np.array(found) for found in taken(place, inputs[first], measured[first]))
            H = F[:3] / NOISE
            gain = np.linalg.solve(H @ P @ H.T + np.eye(3), H @ P).T
            moved = m - gain @ (r[:, 0] + H @ (m - place))
            m = there[:, 0] + F @ (moved - place)
            P = F @ (P - gain @ H @ P) @ F.T + 1e-9 * np.eye(9)
            place, first = there[:, 0], first + 1
        window = slice(first, k)
        rows = [np.vstack([a[window], np.zeros((HORIZON - k + first, a.shape[1]))]) for a in (inputs, measured)]
        L = np.linalg.cholesky(np.linalg.inv(P)).T
        given = np.concatenate([*(a.ravel() for a in rows), np.arange(HORIZON) < k - first, m, L.T.ravel()])
        low, high = np.full(9, -np.inf), np.full(9, np.inf)
        low[8], high[8] = np.log(1e-5), np.log(1e-3)
        place = np.array(solver(x0=place, p=given, lbx=low, ubx=high)["x"])[:, 0]
    return float(np.exp(place[8]))


def of_ours(name: str, inputs: Vector, measured: Vector, start: Vector) -> float:
    """Return the inertia of one of our estimators, which judges roll-outs of the whole log."""

    def residual(theta: dict[str, float], samples: Sequence[Sample]) -> list[float]:
        x = np.array([*list(theta.values())[1:], 0.0, 0.0])
        r = (rolled_out(theta["Theta_1"], x, [np.array(s.u) for s in samples[1:]]) - [s.y for s in samples[1:]]) / NOISE
        return r.ravel().tolist()

    theta = SPACE.from_unit(SPACE.to_unit(np.array([GUESS, *start[:6]])))
    window = EpisodeWindow(FunctionObjective(residual, "residual", SPACE), N)
    window.append(Sample(0.0, (), (), ()))
    window.begin(theta)
    for k, (u, y) in enumerate(zip(inputs.tolist(), measured.tolist(), strict=True), 1):
        window.append(Sample(STEP * k, (), tuple(u), (), tuple(y)))
    method = METHODS[name]
    search = method.estimator(SPACE, theta, np.random.default_rng(0), method.settings())
    if isinstance(search, AskTell):
        for _ in range(OURS[name]):
            candidate = search.ask()
            search.tell(candidate, window.residual(candidate))
    else:
        search.solve(Objective(window, None, OURS[name]))
    return float(search.estimate().theta[0])


def main() -> None:
    """Measure each estimator on each log, print and keep the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    options = parser.parse_args()
    estimators: dict[str, Callable[[Vector, Vector, Vector], float]] = {
        name: lambda *log, name=name: of_ours(name, *log) for name in OURS
    }
    peers = {"do-mpc": ("do_mpc", of_do_mpc), "casadi-ipopt": ("casadi", of_casadi)}
    absent = [name for name, (module, _) in peers.items() if not importlib.util.find_spec(module)]
    estimators |= {name: function for name, (_, function) in peers.items() if name not in absent}
    rows: list[report.Row] = []
    with one_thread():
        for name, function in estimators.items():
            errors, seconds = list[float](), list[float]()
            for seed in range(options.seeds):
                log = log_of(seed)
                begun = process_time()
                errors.append(abs(function(*log) / THETA - 1.0))
                seconds.append(process_time() - begun)
            rows.append({
                "estimator": name, "seeds": options.seeds, "error": report.spread(errors), "worst": max(errors),
                "ms a sample": report.spread(1e3 * np.array(seconds) / N),
            })  # fmt: skip
    report.write("oscillating_masses", rows, "".join(f"{name}: absent, pip install '.[peers]'\n" for name in absent))


if __name__ == "__main__":
    main()
