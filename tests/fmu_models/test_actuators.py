"""The actuators' lag, and what stays bit for bit where lag, disturbances, drag and dry friction are zero."""

import math
from math import sin

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from fmu_models import friction_pendulum, magnetic_levitation, pendulum, quadrotor, rigid_body
from fmu_models.kernel import blocks
from fmu_models.kernel.description import disturbance, input_variable, parameter, state
from fmu_models.kernel.ode import integrate
from fmu_models.kernel.slave import Slave
from fmu_models.kernel.so3 import add, apply, cross, scale, subtract
from fmu_models.magnetic_levitation.plant import MagneticLevitation
from fmu_models.pendulum.plant import Pendulum
from fmu_models.quadrotor.plant import Quadrotor
from tests.mutation import mutation_tests

AREA, Q_0, Q_1, LEAK = 2.0, 1.0, 4.0, -0.5
H_0 = 0.25


def tank(module):
    """A level under an inflow through a valve, and a leak, which has no valve."""

    class Tank(module.PlantSlave):
        """Level that follows an inflow."""

        table = (
            parameter("area", "m2", AREA, "Cross-section", min=0.1),
            disturbance("leak", "m3/s", "Disturbance"),
            input_variable("q", "m3/s", Q_0, "Inflow"),
            state("h", "m", H_0, "Level", depends=("area", "q", "leak")),
        )

        @staticmethod
        def derivative(x, u, area):
            """h_dot = (q + leak)/area."""
            return ((u[0] + u[1]) / area,)

    return Tank


def get(slave, *names):
    order = [v.name for v in slave.variables]
    return slave.get_real([order.index(name) for name in names])


def put(slave, **values):
    order = [v.name for v in slave.variables]
    slave.set_real([order.index(name) for name in values], list(values.values()))


def initialized(model, **values):
    slave = model(instance_name="one")
    slave.setup_experiment(0.0)
    put(slave, **values)
    slave.exit_initialization_mode()
    return slave


# Truth: y = u + (y_0 - u) exp(-t/tau) behind the lag, and its integral.


def check_lag_is_its_closed_form(module):
    """The command steps from 1 to 4 m3/s, and the leak at once, at steps of the host that are no part of tau."""
    for tau in (1e-4, 3e-3, 0.05, 2.0):
        slave = initialized(tank(module), tau_u=tau)
        put(slave, q=Q_1, leak=LEAK)
        for k in range(30):
            slave.do_step(0.02 * k, 0.02)
            t = 0.02 * (k + 1)
            y = Q_1 + (Q_0 - Q_1) * math.exp(-t / tau)
            volume = Q_1 * t + (Q_0 - Q_1) * tau * (1 - math.exp(-t / tau)) + LEAK * t
            h, rate, held, leak = get(slave, "h", "der(h)", "q_held", "leak_held")
            assert_allclose((rate, held, leak), ((y + LEAK) / AREA, Q_1, LEAK), rtol=1e-12)
            # Simpson's rule on exp(-s) at steps of tau is off by 3.4e-4; at a tenth, by 4e-8.
            bound = 4e-4 if tau < 0.05 else 1e-7
            assert_allclose(h, H_0 + volume / AREA, atol=bound * tau * (Q_1 - Q_0) / AREA + 1e-13)


def check_lag_starts_at_the_first_command(module):
    """Until the command changes, a lag shows nowhere."""
    slave = initialized(tank(module), tau_u=0.5, q=3.0)
    assert_allclose(get(slave, "der(h)", "q_held"), (3.0 / AREA, 3.0))
    for k in range(5):
        slave.do_step(0.1 * k, 0.1)
    assert_allclose(get(slave, "h", "der(h)"), (H_0 + 1.5 / AREA, 3.0 / AREA), rtol=1e-14)


def a_rollback_repeats_every_bit(module):
    """In the middle of the lag: the same instance and another go on to the same bits."""
    first, other = (initialized(tank(module), tau_u=0.1) for _ in range(2))
    put(first, q=Q_1)
    first.do_step(0.0, 0.05)
    saved, rate = first._get_fmu_state(), get(first, "der(h)")
    first.do_step(0.05, 0.05)
    expected = get(first, "h", "der(h)")
    put(first, q=-9.0)
    first.do_step(0.1, 0.3)
    for slave in (first, other):
        slave._set_fmu_state(saved)
        assert_allclose(get(slave, "der(h)"), rate, rtol=0)
        slave.do_step(0.05, 0.05)
        assert_allclose(get(slave, "h", "der(h)"), expected, rtol=0)


def check_lag_may_be_switched_on_and_off(module):
    """What a scenario's changes do: from then on it lags from the last command, and behind it no more."""
    slave = initialized(tank(module))
    put(slave, q=Q_1)
    slave.do_step(0.0, 0.1)
    assert_allclose(get(slave, "h", "der(h)"), (H_0 + 0.1 * Q_1 / AREA, Q_1 / AREA))
    put(slave, tau_u=0.2, q=Q_0)
    slave.do_step(0.1, 0.1)
    y = Q_0 + (Q_1 - Q_0) * math.exp(-0.5)
    h, rate = get(slave, "h", "der(h)")
    assert_allclose(rate, y / AREA, rtol=1e-12)
    put(slave, tau_u=0.0)
    assert_allclose(get(slave, "der(h)"), (Q_0 / AREA,))
    slave.do_step(0.2, 0.1)
    assert_allclose(get(slave, "h", "der(h)"), (h + 0.1 * Q_0 / AREA, Q_0 / AREA), rtol=1e-12)
    put(slave, tau_u=0.2)
    slave.do_step(0.3, 0.1)
    assert_allclose(get(slave, "der(h)"), (Q_0 / AREA,), rtol=1e-14)


CHECKS = {name: check for name, check in dict(globals()).items() if name.startswith("check_")}
CLOSED, START, SWITCHED = CHECKS
BLOCKS = "fmu_models.kernel.blocks"
MUTANTS = [
    ("lag-of-twice-the-time", BLOCKS, "exp(-t / tau_u)", "exp(-0.5 * t / tau_u)", (CLOSED, SWITCHED)),
    ("lag-from-the-command", BLOCKS, "b + (a - b) * left", "b", (CLOSED, SWITCHED)),
    ("lag-of-the-wrong-end", BLOCKS, "b + (a - b) * left", "a + (b - a) * left", (CLOSED, SWITCHED)),
    ("lagged-value-is-not-kept", BLOCKS, "self._hidden = list(y(duration))", "pass", (CLOSED, SWITCHED)),
    ("rates-of-the-command", BLOCKS, "u = (*self._hidden, *u[len(self._hidden) :])", "pass", (CLOSED, SWITCHED)),
    ("held-at-the-lag-s-start", BLOCKS, "(*y(t), *u[n:])", "(*y(0.0), *u[n:])", (CLOSED,)),
    ("disturbance-lags", BLOCKS, "inputs.sort(key=lambda v: v.is_disturbance)",
     "inputs.sort(key=lambda v: not v.is_disturbance)", (CLOSED,)),
    ("coarse-steps", BLOCKS, "min(max_step, tau_u))[:-1]", "max_step)[:-1]", (CLOSED,)),
    ("rest-of-the-step-left-out", BLOCKS, "step_size - lagged", "0.0", (CLOSED,)),
    ("starts-at-zero", BLOCKS, "            self._hidden = values[self._controls]\n",
     "            self._hidden = [0.0 for _ in values[self._controls]]\n", (START,)),
]  # fmt: skip

TestMutants = mutation_tests(MUTANTS, CHECKS)


# Bits.


def pendulum_before(x, u, m, l, b, g):
    """The equation as it was without disturbance and dry friction."""
    phi, phi_dot = x
    return (phi_dot, -g / l * sin(phi) - b / m * phi_dot + u[0] / (m * l))


def quadrotor_before(x, u, m, J_x, J_y, J_z, g):
    """The equations as they were without disturbances and drag."""
    _, _, _, vx, vy, vz, r11, r12, r13, r21, r22, r23, r31, r32, r33, p, q, r = x
    F, M_x, M_y, M_z = u
    a = F / m
    return (
        vx, vy, vz,
        -a * r13, -a * r23, g - a * r33,
        r12 * r - r13 * q, r13 * p - r11 * r, r11 * q - r12 * p,
        r22 * r - r23 * q, r23 * p - r21 * r, r21 * q - r22 * p,
        r32 * r - r33 * q, r33 * p - r31 * r, r31 * q - r32 * p,
        (M_x - (J_z - J_y) * q * r) / J_x, (M_y - (J_x - J_z) * p * r) / J_y, (M_z - (J_y - J_x) * p * q) / J_z,
    )  # fmt: skip


def rigid_body_before(x, u, m, c_x, c_y, c_z, J_xx, J_yy, J_zz, J_xy, J_xz, J_yz, g):
    """The accelerations as they were without disturbances and drag, among zeros."""
    Omega, F, c, J = x[15:18], u[0:3], (c_x, c_y, c_z), (J_xx, J_yy, J_zz, J_xy, J_xz, J_yz)
    M_c = subtract(u[3:6], cross(c, F))
    Omega_dot = rigid_body.solve(J, subtract(M_c, cross(Omega, apply(rigid_body.matrix(J), Omega))))
    lever = add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))
    a = apply(x[6:15], subtract(scale(1.0 / m, F), lever))
    return (a[0], a[1], g + a[2], *Omega_dot)


def exact(values):
    """Texts that tell any two floats apart, 0.0 and -0.0 too."""
    return [float(value).hex() for value in values]


def states(oracles):
    rng = np.random.default_rng(60)
    zero = (*(0.0,) * 6, *np.eye(3).ravel().tolist(), *(0.0,) * 3)
    yield zero, (0.0,) * 6
    yield tuple(-x for x in zero), (-0.0,) * 6
    for _ in range(200):
        yield oracles.floats(oracles.random_state(rng)), oracles.floats(rng.normal(0, 5, 6))


@pytest.mark.parametrize("nothing", [(), (0.0,) * 6, (-0.0,) * 6], ids=["left out", "zero", "minus zero"])
def test_without_a_disturbance_every_bit_is_that_of_the_old_formula(oracles, nothing):
    p4, p5 = (2.0, 0.6, 0.3, 9.7), (1.4, 3.0, 2.0, 6.0, 9.7)
    body = (2.2, 0.1, -0.2, 0.3, 0.4, 0.5, 0.6, 0.01, 0.02, -0.03, 9.7)
    for x, u in states(oracles):
        planar, push = x[6:8], nothing[:1]
        got = pendulum.derivative(planar, (u[0], *push), *p4, 0.0)
        assert exact(got) == exact(pendulum_before(planar, u, *p4))
        got = quadrotor.derivative(x, (*u[:4], *nothing), *p5, 0.0)
        assert exact(got) == exact(quadrotor_before(x, u[:4], *p5))
        got = rigid_body.derivative(x, (*u, *nothing), *body, 0.0)
        assert exact((*got[3:6], *got[15:])) == exact(rigid_body_before(x, u, *body))
        for module in (friction_pendulum, magnetic_levitation):
            assert exact(module.derivative(planar, (u[0], *push))) == exact(module.derivative(planar, (u[0],)))
        for module, known, rates in ((pendulum, (u[0],), x[1:2]), (quadrotor, u[:4], u)):
            regression = [
                module.regression(x if known == u[:4] else planar, (*known, *more), rates)
                for more in ((), nothing if known == u[:4] else push)
            ]
            assert repr(regression[0]) == repr(regression[1])


@pytest.mark.parametrize("model", [Pendulum, Quadrotor, MagneticLevitation])
def test_without_a_lag_every_bit_is_that_of_the_held_input(model):
    slave = initialized(model)
    parameters = slave._values[model._physical]
    x = tuple(slave._values[model._states])
    n_controls = sum(v.causality == "input" and not v.is_disturbance for v in model.variables)
    control = next(v.name for v in model.variables if v.causality == "input")
    for k in range(20):
        put(slave, **{control: 0.9 + 0.01 * k})
        slave.do_step(0.004 * k, 0.004)
        u = tuple(slave._values[model._inputs])[:n_controls]
        x = model.project(integrate(lambda x, u=u: model.derivative(x, u, *parameters), x, 0.004, 0.005))
        assert exact(slave._values[model._states]) == exact(x)
        assert exact(get(slave, *(f"der({v.name})" for v in model.variables[model._states]))) == exact(
            model.derivative(x, u, *parameters)
        )


# The plants.


@pytest.mark.parametrize("check", list(CHECKS))
def test_the_lag_is_as_it_should_be(check):
    CHECKS[check](blocks)


def test_a_lag_is_in_the_fmu_state():
    a_rollback_repeats_every_bit(blocks)


def test_a_rollback_that_forgets_the_lag_is_noticed(monkeypatch):
    restore = Slave._set_fmu_state

    def forget(self, state):
        hidden = self._hidden
        restore(self, state)
        self._hidden = hidden

    monkeypatch.setattr(Slave, "_set_fmu_state", forget)
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        a_rollback_repeats_every_bit(blocks)


def test_the_pendulum_behind_a_lag_is_that_of_dop853():
    """Three states, the actuator's force among them, from the command's steps on."""
    tau, h = 0.07, 0.02
    slave = initialized(Pendulum, tau_u=tau, u=2.0, max_step=0.002)
    x = np.array([0.5, 0.0, 2.0])
    for k in range(100):
        u, F_d = 5.0 * math.sin(0.3 * k), 1.0 if k > 50 else 0.0
        put(slave, u=u, F_d=F_d)
        slave.do_step(k * h, h)

        def f(_, x, u=u, F_d=F_d):
            m, l, b = 1.75, 0.75, 0.1
            force = x[2] + F_d - m * 9.81 * np.sin(x[0]) - b * l * x[1]
            return x[1], force / (m * l), (u - x[2]) / tau

        x = solve_ivp(f, (0, h), x, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        # RK4 at h/35 of the lag, and at 2 ms of a swing of 4 rad/s.
        assert_allclose(get(slave, "phi", "phi_dot"), x[:2], atol=1e-8)
        assert_allclose(get(slave, "der(phi_dot)", "u_held", "F_d_held"), [f(0, x)[1], u, F_d], atol=1e-7)


def test_a_lag_is_no_state_of_the_model():
    xml = Pendulum(instance_name="one").to_xml()
    names = [v.get("name") for v in xml.iter("ScalarVariable")]
    assert [names[int(u.get("index")) - 1] for u in xml.find("ModelStructure/Derivatives")] == [
        "der(phi)",
        "der(phi_dot)",
    ]
    assert names.index("F_d") == names.index("u") + 1
