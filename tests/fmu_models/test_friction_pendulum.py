"""The pendulum with stiction and a dead band against independent truths, each of which rejects wrong formulas.

Newton's law is written here in Cartesian coordinates with a taut rod; stick-slip is DOP853 between events, where
stuck is at rest. The checks take the module, so that they can be handed a wrong one.
"""

import inspect
import tomllib
from functools import cache, partial
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fmu_models import friction_pendulum
from fmu_models.friction_pendulum.controller import FrictionPendulumController
from fmu_models.friction_pendulum.plant import FrictionPendulum
from fmu_models.kernel.ode import integrate
from fmu_models.pendulum.reference import PendulumSine
from tests.mutation import mutation_tests

ROUNDING = 1e-11
"""Both sides are a few dozen operations on numbers below 1e3: they differ by rounding alone."""
NAMES = ("m", "l", "F_c", "F_s", "u_d", "b", "g", "phi_dot_s")


# Truth.


def actuated(u, u_d):
    """The force [N] behind the dead band."""
    return np.sign(u) * np.maximum(np.abs(u) - u_d, 0.0)


def level(speed, p):
    """The friction's level [N]: between static and Coulomb's by a bell of height 1 at rest."""
    bell = np.exp(-np.square(speed / p["phi_dot_s"]))
    return bell * (p["F_c"] + p["F_s"]) + (1.0 - bell) * p["F_c"]


def newton(phi, phi_dot, force, p):
    """phi_ddot [rad/s^2] of a point mass on a taut rod under a tangential force [N], gravity and the viscous friction.

    The unknowns are the Cartesian acceleration a and the tension: m a = forces - tension r/l, r . a = -|v|^2.
    """
    m, l = p["m"], p["l"]
    radial, tangent = np.array([np.sin(phi), -np.cos(phi)]), np.array([np.cos(phi), np.sin(phi)])
    v = l * phi_dot * tangent
    forces = force * tangent + np.array([0.0, -m * p["g"]]) - p["b"] * v
    system = np.block([[m * np.eye(2), radial[:, None]], [l * radial[None, :], np.zeros((1, 1))]])
    a = np.linalg.solve(system, [*forces, -(v @ v)])[:2]
    return float(a @ tangent) / l


def cases(seed, n=200):
    """Random parameters and states."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        values = rng.uniform([0.5, 0.3, 0.1, 0.1, 0.1, 0, 5, 0.1], [5, 3, 6, 4, 4, 2, 15, 1])
        yield rng, float(rng.uniform(-np.pi, np.pi)), dict(zip(NAMES, map(float, values), strict=True))


def balance(phi, p):
    """The command [N] at which a pendulum at rest at phi is not driven at all."""
    weight = p["m"] * p["g"] * np.sin(phi)
    return float(weight + np.sign(weight) * p["u_d"])


# Checks.


def check_slip_is_newtons_law(pendulum):
    for rng, phi, p in cases(1):
        phi_dot = float(rng.choice([-1, 1]) * (0.011 + rng.exponential(0.5)))
        u = float(rng.normal(0, 5))
        expected = newton(phi, phi_dot, actuated(u, p["u_d"]) - np.sign(phi_dot) * level(phi_dot, p), p)
        assert_allclose(pendulum.derivative((phi, phi_dot), (u,), **p), (phi_dot, expected), ROUNDING, ROUNDING)


def check_break_away_is_at_the_static_level(pendulum):
    """At rest nothing moves below F_c + F_s; above it, what exceeds it accelerates m l."""
    for rng, phi, p in cases(2):
        phi = float(np.copysign(max(abs(phi), 0.01), phi))
        for sign in (-1.0, 1.0):
            excess = float(rng.uniform(0.001, 1))
            static = p["F_c"] + p["F_s"]
            for margin, expected in ((-min(excess, static), 0.0), (excess, sign * excess / (p["m"] * p["l"]))):
                force = p["m"] * p["g"] * np.sin(phi) + sign * (static + margin)
                u = float(force + np.sign(force) * p["u_d"])
                got = pendulum.derivative((phi, 0.0), (u,), **p)
                assert_allclose(got, (0.0, expected), ROUNDING, ROUNDING)


def check_dead_band_lets_nothing_through(pendulum):
    """Within the band any command is as good as none; beyond, the derivative is a line of slope 1/(m l)."""
    for rng, phi, p in cases(3):
        x = (phi, 1.0)
        idle = pendulum.derivative(x, (0.0,), **p)[1]
        inside, beyond = float(rng.uniform(-1, 1)) * p["u_d"], float(rng.exponential(3))
        got = [pendulum.derivative(x, (u,), **p)[1] for u in (inside, p["u_d"] + beyond, -p["u_d"] - beyond)]
        step = beyond / (p["m"] * p["l"])
        assert_allclose(got, (idle, idle + step, idle - step), ROUNDING, ROUNDING)


def check_a_disturbance_bypasses_the_dead_band(pendulum):
    """In slip it is one more force; at rest, and the actuator in its dead band, it alone breaks the pendulum away."""
    for rng, phi, p in cases(8):
        phi_dot = float(rng.choice([-1, 1]) * (0.011 + rng.exponential(0.5)))
        u, F_d = map(float, rng.normal(0, 5, 2))
        total = actuated(u, p["u_d"]) + F_d - np.sign(phi_dot) * level(phi_dot, p)
        expected = newton(phi, phi_dot, total, p)
        assert_allclose(pendulum.derivative((phi, phi_dot), (u, F_d), **p), (phi_dot, expected), ROUNDING, ROUNDING)
        push = p["F_c"] + p["F_s"] + 0.5
        got = pendulum.derivative((0.0, 0.0), (0.5 * p["u_d"], push), **p)[1]
        assert_allclose(got, 0.5 / (p["m"] * p["l"]), ROUNDING, ROUNDING)


def check_power_is_that_of_the_forces(pendulum):
    """In slip dE/dt = l phi_dot (force behind the dead band - friction - b l phi_dot): friction takes energy only."""
    for rng, phi, p in cases(4):
        m, l, g = p["m"], p["l"], p["g"]
        phi_dot = float(rng.choice([-1, 1]) * (0.011 + rng.exponential(0.5)))
        for u in (0.0, float(rng.normal(0, 8))):
            rate = pendulum.derivative((phi, phi_dot), (u,), **p)[1]
            power = m * l**2 * phi_dot * rate + m * g * l * np.sin(phi) * phi_dot
            taken = l * abs(phi_dot) * (level(phi_dot, p) + p["b"] * l * abs(phi_dot))
            # Differences of terms up to 1e3 W.
            assert_allclose(power, l * phi_dot * actuated(u, p["u_d"]) - taken, 1e-10, 1e-10)


def check_coulomb_friction_stops_a_slide_where_it_should(pendulum):
    """Without gravity phi_dot falls by F_c/(m l) a second: rest after v0 m l/F_c, at v0^2 m l/(2 F_c)."""
    m, l, F_c, v0, band = 1.75, 0.75, 1.0, 2.0, 1e-3
    p = dict(zip(NAMES, (m, l, F_c, 0.0, 0.5, 0.0, 0.0, 0.3), strict=True))
    x = integrate(lambda x: pendulum.derivative(x, (0.0,), **p, phi_dot_0=band, tau=1e-3), (0.0, v0), 4.0, 5e-4)
    # The last 1e-3 rad/s decay with tau instead: angles of band^2 m l/(2 F_c) and band tau, both about 1e-6 rad.
    assert_allclose(x, (v0**2 * m * l / (2 * F_c), 0.0), atol=3e-6)


FORCED = dict(zip(NAMES, (1.75, 0.75, 2.0, 1.5, 0.5, 0.1, 9.81, 0.3), strict=True))


def forcing(t):
    """A command that makes the pendulum slip, stick and reverse."""
    return 4.0 * np.sin(1.7 * t) + 3.0 * np.sin(4.1 * t)


TIMES = np.arange(0.0, 6.001, 0.05)


@cache
def stick_slip_truth():
    """Angles at the times, from DOP853 between events: slip of one sign until rest, rest until |F| = F_c + F_s.

    Returns them and the time spent at rest [s].
    """
    p, times = FORCED, TIMES
    static, end = p["F_c"] + p["F_s"], float(times[-1])

    def driving(t, phi):
        return actuated(forcing(t), p["u_d"]) - p["m"] * p["g"] * np.sin(phi)

    def reached(t, x, sign, phi):
        return abs(driving(t, phi)) - static if sign == 0 else x[1]

    t, x, sign, angles, at_rest = 0.0, np.zeros(2), 0.0, np.full(len(times), np.nan), 0.0
    while t < end:
        phi = float(x[0])

        def f(t, x, sign=sign):
            friction = sign * level(x[1], p)
            return (0.0, 0.0) if sign == 0 else (x[1], newton(x[0], x[1], actuated(forcing(t), p["u_d"]) - friction, p))

        event = partial(reached, sign=sign, phi=phi)
        event.terminal, event.direction = True, 1.0 if sign == 0 else -sign
        run = solve_ivp(
            f, (t, end), x, "DOP853", events=event, rtol=1e-10, atol=1e-12, max_step=0.01, dense_output=True
        )
        mine = (times >= t) & (times <= run.t[-1])
        angles[mine] = run.sol(times[mine])[0]
        at_rest += (run.t[-1] - t) * (sign == 0)
        if run.status != 1:
            break
        t, x = float(run.t[-1]), np.array([run.y[0, -1], 0.0])
        force = driving(t, x[0])
        sign = float(np.sign(force)) if sign == 0 or abs(force) > static else 0.0
    return angles, at_rest


def check_stick_slip_is_that_between_events(pendulum):
    """The error falls with the band: ten times narrower, some ten times less."""
    truth, at_rest = stick_slip_truth()
    assert 1.0 < at_rest < 5.0
    errors = []
    for band, step in ((1e-2, 1e-3), (1e-3, 2e-4)):

        def f(x, band=band):
            u = (float(forcing(x[2])),)
            return (*pendulum.derivative(x[:2], u, **FORCED, phi_dot_0=band, tau=band), 1.0)

        x, angles = (0.0, 0.0, 0.0), [0.0]
        for _ in TIMES[1:]:
            x = integrate(f, x, 0.05, step)
            angles.append(x[0])
        errors.append(np.abs(np.subtract(angles, truth)).max())
    # Both are of first order in the band: it is left and reached at a velocity that is off by it, for up to a second.
    assert_allclose(errors, 0.0, atol=1e-2)
    assert_allclose(errors[1], 0.0, atol=1e-3)


def check_a_stuck_pendulum_neither_chatters_nor_creeps(pendulum):
    """At the FMU's band and steps, wherever h F_static/(m l) <= phi_dot_0: a slip that the static level can hold ends
    in the band, and there its speed falls at each step."""
    band, tau = 0.01, 0.01
    for rng, phi, p in cases(5):
        static = p["F_c"] + p["F_s"]
        h = min(0.005, 0.99 * band * p["m"] * p["l"] / static)
        # Held against the slip and with it, but for what viscous friction adds.
        u = balance(phi, p) + float(rng.uniform(-0.6, 0.6)) * static
        x = (phi, float(rng.choice([-1, 1])) * band * 1.0001)
        f = partial(lambda x, u, p: pendulum.derivative(x, (u,), **p, phi_dot_0=band, tau=tau), u=u, p=p)
        for _ in range(5):  # a step or two until it is in
            if abs(x[1]) <= band:
                break
            x = integrate(f, x, h, h)
        speeds, start = [x[1]], x[0]
        for _ in range(int(0.3 / h)):
            x = integrate(f, x, h, h)
            speeds.append(x[1])
        if abs(speeds[0]) > band:  # it slips on: driven the way it goes, above Coulomb's level
            continue
        assert_allclose(np.diff(np.abs(speeds)).clip(0.0), 0.0, atol=0)
        assert_allclose(np.min(np.multiply(speeds, np.sign(speeds[0]))).clip(None, 0.0), 0.0, atol=0)
        assert_allclose(abs(x[0] - start), 0.0, atol=1.01 * band * tau)
        assert_allclose(abs(x[1]), 0.0, atol=1e-12 * band + band * np.exp(-0.29 / tau))


def commanded(pendulum, phi, phi_dot, x_ref, p, ramps=(1e-6, 1e-6)):
    """The command with gains 10 and 5, and the acceleration that the law wants."""
    values = [p[name] for name in NAMES]
    wanted = x_ref[2] + 10.0 * (x_ref[0] - phi) + 5.0 * (x_ref[1] - phi_dot)
    return pendulum.control((phi, phi_dot), x_ref, *values, 10.0, 5.0, *ramps), wanted


def check_control_gives_the_linear_error_law(pendulum):
    """Newton's law under the commanded force, wherever the desired velocity has the measured one's sign."""
    for rng, phi, p in cases(6):
        phi_dot = float(rng.normal(0, 1))
        x_ref = (float(rng.normal()), float(np.copysign(rng.uniform(0.1, 2), phi_dot)), float(rng.normal(0, 5)))
        u, wanted = commanded(pendulum, phi, phi_dot, x_ref, p)
        got = newton(phi, phi_dot, actuated(u, p["u_d"]) - np.sign(phi_dot) * level(phi_dot, p), p)
        assert_allclose(got, wanted, 1e-9, 1e-9)


def check_control_breaks_away_and_does_not_jump_at_a_reversal(pendulum):
    """At rest it commands the static level in the direction of the desired velocity, on top of what it wants; as that
    velocity passes zero, or the force does, the command is continuous."""
    for rng, phi, p in cases(7):
        sign = float(rng.choice([-1.0, 1.0]))
        u, wanted = commanded(pendulum, phi, 0.0, (phi, sign * 0.5, 0.0), p)
        driving = actuated(u, p["u_d"]) - p["m"] * p["g"] * np.sin(phi)
        expected = p["m"] * p["l"] * wanted + sign * (p["F_c"] + p["F_s"])
        assert_allclose(driving, expected, 1e-9, 1e-9)
        u_minus, u_plus = (commanded(pendulum, phi, 0.1, (0.0, v, 0.0), p, (0.02, 0.05))[0] for v in (-1e-9, 1e-9))
        # Slopes: below 5 m l + friction/0.02, times 1 + u_d/0.05: 4e4 N s/rad.
        assert_allclose(u_plus - u_minus, 0.0, atol=2e-4)
        held = -p["g"] * np.sin(phi) / p["l"]
        u_minus, u_plus = (
            commanded(pendulum, phi, 0.0, (phi, 0.0, held + e), p, (0.02, 0.05))[0] for e in (-1e-9, 1e-9)
        )
        # There the force is zero: slope m l (1 + u_d/0.05) below 1300 kg m.
        assert_allclose((u_minus, u_plus), 0.0, atol=1e-5)


CHECKS = {name: check for name, check in dict(globals()).items() if name.startswith("check_")}
SLIP, POWER, STOP = (
    "check_slip_is_newtons_law",
    "check_power_is_that_of_the_forces",
    "check_coulomb_friction_stops_a_slide_where_it_should",
)
BREAK_AWAY, DEAD_BAND = "check_break_away_is_at_the_static_level", "check_dead_band_lets_nothing_through"
STICK_SLIP, STUCK = "check_stick_slip_is_that_between_events", "check_a_stuck_pendulum_neither_chatters_nor_creeps"
PUSHED = "check_a_disturbance_bypasses_the_dead_band"
LAW, REVERSAL = (
    "check_control_gives_the_linear_error_law",
    "check_control_breaks_away_and_does_not_jump_at_a_reversal",
)

FRICTION_PENDULUM = "fmu_models.friction_pendulum.equations"
MUTANTS = [
    # id, old, new, the checks that must reject it
    ("gravity-up", "u_d) - m * g * sin(phi)", "u_d) + m * g * sin(phi)", (SLIP, POWER, BREAK_AWAY, STICK_SLIP)),
    ("gravity-of-a-torque", "u_d) - m * g * sin(phi)", "u_d) - m * g * l * sin(phi)", (SLIP, BREAK_AWAY)),
    ("push-against", "force += u[1]", "force -= u[1]", (PUSHED,)),
    ("push-lost", "force += u[1]", "force += 0.0", (PUSHED,)),
    ("viscous-drives", "sin(phi) - b * l * phi_dot", "sin(phi) + b * l * phi_dot", (SLIP, POWER)),
    ("viscous-without-length", "sin(phi) - b * l * phi_dot", "sin(phi) - b * phi_dot", (SLIP, POWER)),
    ("friction-drives", "(force - friction)", "(force + friction)", (SLIP, POWER, STOP, BREAK_AWAY)),
    ("friction-without-mass", "(m * l))", "l)", (SLIP, STOP, BREAK_AWAY, DEAD_BAND)),
    ("friction-against-the-force-in-slip", "phi_dot_s), phi_dot)", "phi_dot_s), force)", (SLIP, POWER, STICK_SLIP)),
    ("static-level-is-coulombs", "elif abs(force) > F_c + F_s:", "elif abs(force) > F_c:", (BREAK_AWAY,)),
    ("static-level-is-the-excess", "elif abs(force) > F_c + F_s:", "elif abs(force) > F_s:", (BREAK_AWAY,)),
    ("breaks-away-without-friction", "copysign(F_c + F_s, force)", "0.0", (BREAK_AWAY,)),
    ("breaks-away-the-way-it-moved", "copysign(F_c + F_s, force)", "copysign(F_c + F_s, phi_dot)", (BREAK_AWAY,)),
    ("never-sticks", "abs(phi_dot) > phi_dot_0", "abs(phi_dot) > -1.0", (BREAK_AWAY, STUCK)),
    ("drifts-where-it-sticks", "-phi_dot / tau", "0.0", (STUCK, STICK_SLIP)),
    ("runs-off-where-it-sticks", "-phi_dot / tau", "phi_dot / tau", (STUCK, STICK_SLIP)),
    ("stops-too-hard-for-the-step", "-phi_dot / tau", "-phi_dot / (0.1 * tau)", (STUCK,)),
    ("dead-band-clips", "return u - min(max(u, -u_d), u_d)", "return min(max(u, -u_d), u_d)", (SLIP, DEAD_BAND)),
    ("dead-band-without-offset", "return u - min(max(u, -u_d), u_d)", "return u if abs(u) > u_d else 0.0",
     (SLIP, POWER, DEAD_BAND, BREAK_AWAY)),
    ("dead-band-of-one-sign", "min(max(u, -u_d), u_d)", "min(max(u, 0.0), u_d)", (SLIP, DEAD_BAND)),
    ("stribeck-rises", "exp(-ratio * ratio)", "(1.0 - exp(-ratio * ratio))", (SLIP, POWER, STICK_SLIP, REVERSAL)),
    ("stribeck-of-tustin", "exp(-ratio * ratio)", "exp(-abs(ratio))", (SLIP, POWER, LAW)),
    ("stribeck-of-the-level", "return F_c + F_s * exp", "return F_c + (F_s - F_c) * exp", (SLIP, POWER, LAW)),
    ("control-torque", "m * l * acceleration", "m * l**2 * acceleration", (LAW,)),
    ("control-gravity-sign", "acceleration + m * g", "acceleration - m * g", (LAW, REVERSAL)),
    ("control-viscous-sign", "+ b * l * phi_dot + friction", "- b * l * phi_dot + friction", (LAW,)),
    ("control-without-feedforward", "acceleration = phi_ddot_ref +", "acceleration =", (LAW,)),
    ("control-gains-swapped", "Kp * (phi_ref - phi) + Kd * (", "Kd * (phi_ref - phi) + Kp * (", (LAW, REVERSAL)),
    ("control-friction-sign", "phi_dot + friction", "phi_dot - friction", (LAW, REVERSAL)),
    ("control-friction-of-the-measured-sign", "_ramp(phi_dot_ref, phi_dot_w)", "_ramp(phi_dot, phi_dot_w)",
     (REVERSAL,)),
    ("control-friction-at-the-desired-speed", "stribeck(phi_dot, F_c, F_s, phi_dot_s)\n    force",
     "stribeck(phi_dot_ref, F_c, F_s, phi_dot_s)\n    force", (LAW, REVERSAL)),
    ("control-without-inverse", "force + u_d * _ramp(force, F_w)", "force", (LAW, REVERSAL)),
    ("control-jumps", "min(max(z / width, -1.0), 1.0)", "copysign(1.0, z)", (REVERSAL,)),
]  # fmt: skip

TestMutants = mutation_tests([(name, FRICTION_PENDULUM, *mutant) for name, *mutant in MUTANTS], CHECKS)


@pytest.mark.parametrize("check", list(CHECKS))
def test_the_model_agrees_with_the_truth(check):
    CHECKS[check](friction_pendulum)


# The FMUs' tables and the scenario.


def test_the_model_s_defaults_are_the_fmu_s_starts():
    """So that what the estimator does not name is what the plant has."""
    defaults = {k: p.default for k, p in inspect.signature(friction_pendulum.derivative).parameters.items()}
    starts = {v.name: v.start for v in FrictionPendulum.variables if v.causality == "parameter"}
    assert (starts.pop("tau_u"), starts.pop("max_step")) == (0.0, 0.005)
    assert list(defaults)[2:] == list(starts)
    assert {name: defaults[name] for name in starts} == starts
    believed = {v.name: v.start for v in FrictionPendulumController.variables if v.name in starts}
    assert believed == {name: starts[name] for name in NAMES}


def test_the_sine_s_velocity_and_acceleration_are_its_derivatives(oracles):
    parameters = (0.6, 1.5, -0.2, 6.0)
    outputs = partial(PendulumSine.outputs, None)

    def angle(t):
        return 0.6 * np.sin(1.5 * t) - 0.2 * np.sin(6.0 * t)

    for t in np.linspace(0.0, 10.0, 21):
        expected = oracles.taylor(lambda s, t=t: angle(t + s), 0.3)
        assert_allclose(outputs(float(t), parameters), np.ravel(expected), atol=1e-9)


SCENARIO = tomllib.loads((files("cosim") / "scenarios" / "stiction.toml").read_text(encoding="utf-8"))


def theta(t):
    """The plant's five parameters at t [s], by the scenario."""
    return {
        name.partition(".")[2]: next(value for start, value in reversed(steps) if t >= start - 1e-9)
        for name, steps in SCENARIO["changes"].items()
    }


def closed_loop(believed):
    """Rows (t, phi, phi_dot, u, phi_ref) of the scenario, its controller with the parameters believed(t)."""
    step = SCENARIO["scenario"]["macro_step"]
    start = SCENARIO["components"]["plant"]["start"]
    sine = [v.start for v in PendulumSine.variables if v.causality == "parameter"]
    own = {v.name: v.start for v in FrictionPendulumController.variables if v.causality == "parameter"}
    x, rows = (start["phi"], start["phi_dot"]), []
    assert_allclose(x, PendulumSine.outputs(None, 0.0, sine)[:2], atol=1e-12)
    for k in range(round(SCENARIO["scenario"]["stop_time"] / step)):
        t = k * step
        u = friction_pendulum.control(x, PendulumSine.outputs(None, t, sine), **(own | believed(t)))
        p = theta(t)
        x = integrate(lambda x, u=u, p=p: friction_pendulum.derivative(x, (u,), **p), x, step, start["max_step"])
        rows.append((t + step, *x, u, PendulumSine.outputs(None, t + step, sine)[0]))
    return np.array(rows)


@pytest.fixture(scope="module")
def nominal():
    """The closed loop whose controller is left alone."""
    return closed_loop(lambda t: theta(0.0))


def test_the_nominal_controller_does_badly_and_the_true_parameters_well(nominal):
    def mse(rows):
        return np.mean((rows[:, 1] - rows[:, 4]) ** 2)

    assert mse(closed_loop(theta)) < 4e-6
    assert mse(nominal) > 5e-3


def searched():
    """The scenario's bounds: functions from parameters to the unit cube and back."""
    bounds = SCENARIO["estimation"]["parameters"]
    names = [b["name"] for b in bounds]
    lower, upper = np.array([(b["lower"], b["upper"]) for b in bounds]).T
    is_log = np.array([b.get("scale") == "log" for b in bounds])
    ratio = np.where(is_log, upper / np.where(is_log, lower, 1.0), np.e)

    def to_unit(p):
        values = np.array([p[name] for name in names])
        return np.where(is_log, np.log(values / np.where(is_log, lower, values)), values - lower) / np.where(
            is_log, np.log(ratio), upper - lower
        )

    def from_unit(z):
        values = np.where(is_log, lower * ratio**z, lower + z * (upper - lower))
        return dict(zip(names, values.tolist(), strict=True))

    return to_unit, from_unit


def residual_of(rows, begin, end):
    """The whitened residual over begin < t <= end as a function in the unit cube; zero at the true parameters."""
    sigma = SCENARIO["sampling"]["derivatives"]["plant.der(phi_dot)"]["noise"]
    to_unit, from_unit = searched()
    rows = rows[(rows[:, 0] > begin + 0.005) & (rows[:, 0] < end + 0.005)]

    def modelled(z):
        p = from_unit(z)
        return np.array([friction_pendulum.derivative((r[1], r[2]), (r[3],), **p)[1] for r in rows])

    true = to_unit(theta(end))
    sampled = modelled(true)
    return true, lambda z: (modelled(z) - sampled) / sigma


@pytest.mark.parametrize(("begin", "is_seen"), [(3.0, True), (4.0, False)], ids=["the-first-second", "the-next-second"])
def test_the_first_second_after_the_change_shows_all_five_parameters(nominal, begin, is_seen):
    """Singular values of the whitened residual's Jacobian at the truth, in the unit cube of the bounds.

    1e3 fixes the worst direction to a thousandth of its range, 1 not at all. What the nominal controller does in the
    next second shows less: it is stuck, or slips one way under force that way, where F_c and u_d are one.
    """
    true, residual = residual_of(nominal, begin, begin + 1.0)
    # Steps of 1e-5 of the range: rounding of 1e-15 * 10 rad/s2 / 1e-5 / sigma, 1e-6; no sample crosses an edge.
    jacobian = np.stack([(residual(true + e) - residual(true - e)) / 2e-5 for e in 1e-5 * np.eye(5)], axis=1)
    s = np.linalg.svd(jacobian, compute_uv=False)
    assert s.shape == (5,)
    assert s[-1] > 1e3 if is_seen else s[-1] < 1.0


def test_local_least_squares_stops_short_from_the_nominal_parameters(nominal):
    """Trust-region reflective on samples without noise, whose least sum is zero: what is left is a local minimum."""
    true, residual = residual_of(nominal, 3.0, 4.0)
    to_unit, _ = searched()
    near = least_squares(residual, true + 0.02 * np.array([1, -1, 1, -1, 1]), bounds=(0.0, 1.0))
    stopped = least_squares(residual, to_unit(theta(0.0)), bounds=(0.0, 1.0), max_nfev=200)
    assert stopped.status > 0
    assert_allclose(near.x, true, atol=1e-4)
    # In standard deviations of the noise.
    assert np.sqrt(np.mean(stopped.fun**2)) > 10.0
