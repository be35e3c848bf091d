"""Each oracle rejects wrong formulas: the source of a module with one slip in it, and the check that must see it.

A check that passes on a mutant cannot bite. Every check of oracles.py is here at least once.
"""

from importlib.resources import files
from types import ModuleType

import numpy as np
import pytest


def mutant(name, old, new):
    """The module `fmu_models.name` from its source with the one `old` replaced by `new`, or unchanged where empty."""
    source = files("fmu_models").joinpath(f"{name}.py").read_text(encoding="utf-8")
    assert not old or source.count(old) == 1, f"{old!r} must be in {name}.py once, got {source.count(old)}"
    module = ModuleType(f"fmu_models.{name}_mutant")
    module.__package__ = "fmu_models"
    exec(compile(source.replace(old, new) if old else source, f"mutant of {name}.py", "exec"), module.__dict__)
    return module


def on_samples(check, *sizes):
    """The check of a property with arguments of these sizes (0: a number), on twenty random samples."""

    def run(module):
        rng = np.random.default_rng(0)
        for _ in range(20):
            arguments = [rng.normal(0, 1, n or None) for n in sizes]
            check(module, *(float(a) if np.ndim(a) == 0 else tuple(map(float, a)) for a in arguments))

    return run


@pytest.fixture(scope="module")
def checks(oracles):
    """All the checks by name, as functions of the module alone."""

    def orthonormalized(module):
        rng = np.random.default_rng(0)
        for _ in range(20):
            oracles.check_orthonormalized(module, rng.normal(0, 1, 3), rng.uniform(-0.05, 0.05, 9))

    def convergence(module):
        oracles.check_order_of_convergence(module, lambda x: (x[1], -np.sin(x[0])), (1.0, 0.5), 3.0, (80, 160))

    return {name: check for name, check in vars(oracles).items() if name.startswith("check_")} | {
        "check_vector_algebra": on_samples(oracles.check_vector_algebra, 3, 3, 0),
        "check_matrix_algebra": on_samples(oracles.check_matrix_algebra, 9, 9, 3),
        "check_vee": on_samples(oracles.check_vee, 9, 3),
        "check_unit_derivatives": on_samples(oracles.check_unit_derivatives, 3, 3, 3),
        "check_orthonormalized": orthonormalized,
        "check_order_of_convergence": convergence,
    }


PENDULUM_MUJOCO = "check_pendulum_derivative_against_mujoco"
PENDULUM_CONTROL = "check_pendulum_control_against_mujoco_inverse_dynamics"
PENDULUM_ENERGY = "check_pendulum_energy_balance"
PENDULUM_SWING = "check_pendulum_swing_against_elliptic_functions"
PENDULUM_LOOP = "check_pendulum_closed_loop_error"
BODY_MUJOCO = "check_quadrotor_derivative_against_mujoco"
BODY_ROTORPY = "check_quadrotor_derivative_against_rotorpy"
BODY_BALANCE = "check_quadrotor_momentum_and_energy_balance"
DESIRED = "check_desired_attitude_against_spectral_differences"
ATTITUDE_ERROR = "check_control_gives_linear_attitude_error_dynamics"
CONTROL_ROTORPY = "check_control_against_rotorpy"
POSITION_LOOP = "check_closed_loop_position_error_is_linear"
SINUSOID = "check_sinusoid_against_spectral_differences"
TRAJECTORY = "check_trajectory_derivatives_against_spectral_differences"
YAW_RATES = "check_yaw_rates_against_spectral_differences"
PAPER_YAW = "check_paper_yaw"
RIGID_MUJOCO = "check_rigid_body_derivative_against_mujoco"
RIGID_BALANCE = "check_rigid_body_momentum_and_energy_balance"
RIGID_FLIGHT = "check_rigid_body_free_flight"
RIGID_ERRORS = "check_rigid_body_control_gives_linear_errors"
RIGID_LOOP = "check_rigid_body_closed_loop_errors"
RIGID_MOTION = "check_rigid_body_motion_against_spectral_differences"
ORDER_CONDITIONS = "check_order_conditions"
CONVERGENCE = "check_order_of_convergence"
UNIT = "check_unit_derivatives"

BODY = (BODY_MUJOCO, BODY_ROTORPY)
LAW = (ATTITUDE_ERROR, POSITION_LOOP)
RIGID = (RIGID_MUJOCO, RIGID_BALANCE)
RIGID_LAW = (RIGID_ERRORS, RIGID_LOOP)

MUTANTS = [
    # id, module, old, new, the checks that must reject it
    ("gravity-up", "pendulum", "-g / l * sin(phi) -", "g / l * sin(phi) -",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY, PENDULUM_SWING, PENDULUM_LOOP)),
    ("gravity-without-length", "pendulum", "-g / l * sin(phi) -", "-g * sin(phi) -", (PENDULUM_MUJOCO, PENDULUM_SWING)),
    ("small-angle", "pendulum", "-g / l * sin(phi) -", "-g / l * phi -", (PENDULUM_MUJOCO, PENDULUM_SWING)),
    ("friction-drives", "pendulum", "- b / m * phi_dot", "+ b / m * phi_dot", (PENDULUM_MUJOCO, PENDULUM_ENERGY)),
    ("friction-without-mass", "pendulum", "- b / m * phi_dot", "- b * phi_dot", (PENDULUM_MUJOCO, PENDULUM_LOOP)),
    ("friction-of-a-torque", "pendulum", "- b / m * phi_dot", "- b / (m * l**2) * phi_dot",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY)),
    ("input-is-a-torque", "pendulum", "u[0] / (m * l))", "u[0] / (m * l**2))",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY, PENDULUM_LOOP)),
    ("control-torque", "pendulum", "m * l * (Kp * e1", "m * l**2 * (Kp * e1", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-gravity-sign", "pendulum", "m * l * (g / l", "-m * l * (g / l", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-friction-sign", "pendulum", "+ b / m * phi_dot", "- b / m * phi_dot", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-error-sign", "pendulum", "x_ref[1] - phi_dot", "phi_dot - x_ref[1]", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-gains-swapped", "pendulum", "Kp * e1 + Kd * e2", "Kd * e1 + Kp * e2", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("thrust-down", "quadrotor", "    a = F / m\n", "    a = -F / m\n", (*BODY, BODY_BALANCE, POSITION_LOOP)),
    ("thrust-without-mass", "quadrotor", "    a = F / m\n", "    a = F\n", (*BODY, BODY_BALANCE)),
    ("thrust-along-third-row", "quadrotor", "-a * r13, -a * r23,", "-a * r31, -a * r32,", (*BODY, BODY_BALANCE)),
    ("gravity-up-z", "quadrotor", "g - a * r33", "-g - a * r33", (*BODY, BODY_BALANCE)),
    ("rotation-the-other-way", "quadrotor", "r12 * r - r13 * q, r13 * p - r11 * r, r11 * q - r12 * p",
     "r13 * q - r12 * r, r11 * r - r13 * p, r12 * p - r11 * q", (*BODY, BODY_BALANCE)),
    ("rates-in-the-world", "quadrotor", "r22 * r - r23 * q,", "r31 * p - r11 * r,", (*BODY, BODY_BALANCE)),
    ("gyroscopic-sign", "quadrotor", "(M_x - (J_z - J_y) * q * r)", "(M_x + (J_z - J_y) * q * r)",
     (*BODY, BODY_BALANCE)),
    ("gyroscopic-none", "quadrotor", "(M_y - (J_x - J_z) * p * r)", "M_y", (*BODY, BODY_BALANCE)),
    ("inertia-of-the-wrong-axis", "quadrotor", "(J_y - J_x) * p * q) / J_z", "(J_y - J_x) * p * q) / J_y",
     (*BODY, BODY_BALANCE)),
    ("heading-mirrored", "quadrotor", "h = (c, s, 0.0)", "h = (c, -s, 0.0)", (DESIRED, CONTROL_ROTORPY, POSITION_LOOP)),
    ("third-axis-up", "quadrotor", "unit_derivatives(scale(-1.0, A), scale(-1.0, A_dot), scale(-1.0, A_ddot))",
     "unit_derivatives(A, A_dot, A_ddot)", (DESIRED, CONTROL_ROTORPY)),
    ("yaw-rate-unused", "quadrotor", "h_dot = (-psi_dot * s, psi_dot * c, 0.0)", "h_dot = (0.0, 0.0, 0.0)",
     (DESIRED, ATTITUDE_ERROR, POSITION_LOOP)),
    ("yaw-centripetal-none", "quadrotor", "-psi_ddot * s - psi_dot**2 * c", "-psi_ddot * s", (DESIRED, *LAW)),
    ("second-product-rule", "quadrotor", "scale(2.0, cross(b3_dot, h_dot))", "cross(b3_dot, h_dot)", (DESIRED, *LAW)),
    ("third-product-rule", "quadrotor", "scale(2.0, cross(b2_dot, b3_dot))", "cross(b2_dot, b3_dot)", (DESIRED, *LAW)),
    ("gravity-in-the-law", "quadrotor", "d.a[2] - g)", "d.a[2] + g)", (*LAW, CONTROL_ROTORPY)),
    ("thrust-of-z-up", "quadrotor", "    F = -dot(A, b3)\n", "    F = dot(A, b3)\n", (*LAW, CONTROL_ROTORPY)),
    ("reference-turn-only", "quadrotor", "A_dot = _feedback(gains, e_v, e_a, m, d.j)", "A_dot = scale(m, d.j)", LAW),
    ("reference-turn-only-second", "quadrotor", "A_ddot = _feedback(gains, e_a, e_j, m, d.s)", "A_ddot = scale(m, d.s)",
     LAW),
    ("acceleration-without-thrust", "quadrotor", "add(scale(F / m, b3), d.a)", "d.a", LAW),
    ("acceleration-without-gravity", "quadrotor", "subtract((0.0, 0.0, g), add(", "subtract((0.0, 0.0, 0.0), add(",
     LAW),
    ("thrust-direction-held", "quadrotor", "add(scale(F_dot / m, b3), scale(F / m, b3_dot))", "scale(F_dot / m, b3)",
     LAW),
    ("thrust-held", "quadrotor", "F_dot = -dot(A_dot, b3) - dot(A, b3_dot)", "F_dot = 0.0", LAW),
    ("thrust-rate-without-turn", "quadrotor", "F_dot = -dot(A_dot, b3) - dot(A, b3_dot)", "F_dot = -dot(A_dot, b3)",
     (ATTITUDE_ERROR,)),  # where R = R_d, A is along b3 and the dropped term is nil
    ("turn-of-the-thrust-axis", "quadrotor", "(Omega[1], -Omega[0], 0.0)", "(-Omega[1], Omega[0], 0.0)", LAW),
    ("attitude-error-sign", "quadrotor", "e_R = scale(-1.0, vee(Q))", "e_R = vee(Q)",
     (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("attitude-error-twice", "quadrotor", "e_R = scale(-1.0, vee(Q))", "e_R = scale(-2.0, vee(Q))",
     (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("attitude-error-in-the-desired-frame", "quadrotor", "Q = product(transpose(R), desired.R)",
     "Q = product(desired.R, transpose(R))", (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("desired-rate-nil", "quadrotor", "Omega_d = apply(Q, desired.Omega)", "Omega_d = (0.0, 0.0, 0.0)", LAW),
    ("desired-rate-unturned", "quadrotor", "Omega_d = apply(Q, desired.Omega)", "Omega_d = desired.Omega",
     (ATTITUDE_ERROR,)),  # where R = R_d nothing is to be turned
    ("feedforward-sign", "quadrotor", "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = subtract(apply(Q, desired.Omega_dot), cross(Omega, Omega_d))", LAW),
    ("feedforward-without-turn", "quadrotor",
     "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = scale(-1.0, apply(Q, desired.Omega_dot))", (ATTITUDE_ERROR,)),  # nil where Omega = Omega_d
    ("feedforward-without-acceleration", "quadrotor",
     "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = cross(Omega, Omega_d)", LAW),
    ("feedforward-without-inertia", "quadrotor", "multiply(J, feedforward)", "feedforward", LAW),
    ("gyroscopic-compensation", "quadrotor", "cross(Omega, multiply(J, Omega))", "cross(multiply(J, Omega), Omega)",
     (*LAW, CONTROL_ROTORPY)),
    ("feedback-of-position", "quadrotor", "-K_r[1] * e[1]", "K_r[1] * e[1]", (*LAW, CONTROL_ROTORPY)),
    ("feedback-of-the-wrong-axis", "quadrotor", "K_v[2] * e_dot[2]", "K_v[0] * e_dot[2]", (*LAW, CONTROL_ROTORPY)),
    ("feedback-without-mass", "quadrotor", "m * a[0]", "a[0]", (*LAW, CONTROL_ROTORPY)),
    ("jerk-sign", "references", "-(omega**3) * c", "omega**3 * c", (SINUSOID, TRAJECTORY)),
    ("snap-order", "references", "omega**4 * s", "omega**3 * s", (SINUSOID, TRAJECTORY)),
    ("velocity-phase", "references", "(s, omega * c,", "(s, omega * s,", (SINUSOID, TRAJECTORY)),
    ("x-at-single-rate", "references", "sinusoid(t, a1, 2.0 * omega)", "sinusoid(t, a1, omega)", (TRAJECTORY,)),
    ("z-amplitude", "references", "sinusoid(t, a3, omega)", "sinusoid(t, a2, omega)", (TRAJECTORY,)),
    ("yaw-of-x-over-y", "references", "    psi = atan2(a2, p)\n", "    psi = atan2(p, a2)\n",
     (TRAJECTORY, YAW_RATES, PAPER_YAW)),
    ("yaw-rate-sign", "references", "psi_dot = -a2 * p_dot / n", "psi_dot = a2 * p_dot / n", (YAW_RATES,)),
    ("yaw-acceleration-quotient", "references", "2.0 * a2 * p * p_dot**2", "a2 * p * p_dot**2", (YAW_RATES,)),
    ("yaw-never-jumps", "references", "psi -= pi", "psi -= 0.0", (PAPER_YAW,)),
    ("yaw-jumps-by-half", "references", "psi -= pi", "psi -= pi / 2", (TRAJECTORY, PAPER_YAW)),
    ("yaw-jumps-up", "references", "psi -= pi", "psi += pi", (PAPER_YAW,)),
    ("yaw-limit-from-the-left", "references", "(sin(omega * t) or cos(omega * t)) < 0.0",
     "(sin(omega * t) or -cos(omega * t)) < 0.0", (PAPER_YAW,)),
    ("moment-arm-sign", "rigid_body", "subtract(u[3:6], cross(c, F))", "add(u[3:6], cross(c, F))",
     (*RIGID, RIGID_LOOP)),
    ("moment-about-the-centre", "rigid_body", "subtract(u[3:6], cross(c, F))", "u[3:6]", (*RIGID, RIGID_LOOP)),
    ("euler-gyroscopic-sign", "rigid_body", "subtract(M_c, cross(Omega, apply(matrix(J), Omega)))",
     "add(M_c, cross(Omega, apply(matrix(J), Omega)))", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("euler-gyroscopic-none", "rigid_body", "subtract(M_c, cross(Omega, apply(matrix(J), Omega)))", "M_c",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("acceleration-of-the-centre", "rigid_body", "a = apply(x[6:15], subtract(scale(1.0 / m, F), "
     "_lever(c, Omega, Omega_dot)))", "a = apply(x[6:15], scale(1.0 / m, F))", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("lever-sign", "rigid_body", "subtract(scale(1.0 / m, F), _lever", "add(scale(1.0 / m, F), _lever",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("lever-without-centripetal", "rigid_body", "return add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))",
     "return cross(Omega_dot, c)", (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),  # the same slip in the law makes up for it
    ("lever-without-acceleration", "rigid_body", "return add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))",
     "return cross(Omega, cross(Omega, c))", (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),
    ("body-gravity-up", "rigid_body", "g + a[2],", "-g + a[2],", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("force-in-the-world", "rigid_body", "    a = apply(x[6:15], sub", "    a = apply(transpose(x[6:15]), sub",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("body-turns-the-other-way", "rigid_body", "r22 * r - r23 * q,", "r23 * q - r22 * r,",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("products-swapped", "rigid_body", "(xx, xy, xz, xy, yy, yz, xz, yz, zz)", "(xx, xz, xy, xz, yy, yz, xy, yz, zz)",
     (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),
    ("products-as-sums", "rigid_body", "    xx, yy, zz, xy, xz, yz = J\n    a_xx",
     "    xx, yy, zz, xy, xz, yz = *J[:3], *scale(-1.0, J[3:])\n    a_xx", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("cofactor-sign", "rigid_body", "xz * yz - xy * zz", "xy * zz - xz * yz", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("determinant-term", "rigid_body", "+ xz * a_xz\n", "- xz * a_xz\n", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("law-moment-arm-sign", "rigid_body", "cross(Omega, apply(J_matrix, Omega))), cross(c, F))",
     "cross(Omega, apply(J_matrix, Omega))), cross(F, c))", RIGID_LAW),
    ("law-without-lever", "rigid_body", "_lever(c, Omega, alpha)", "(0.0, 0.0, 0.0)", RIGID_LAW),
    ("law-lever-of-the-rates-alone", "rigid_body", "_lever(c, Omega, alpha)", "_lever(c, Omega, (0.0, 0.0, 0.0))",
     RIGID_LAW),
    ("law-gravity", "rigid_body", "subtract(a, (0.0, 0.0, g))", "add(a, (0.0, 0.0, g))", RIGID_LAW),
    ("law-force-in-the-world", "rigid_body", "apply(R_T, subtract(a,", "apply(transpose(R_T), subtract(a,", RIGID_LAW),
    ("law-position-feedback", "rigid_body", "add(scale(gains.K_r, e_r), scale(gains.K_v, e_v))",
     "add(scale(gains.K_v, e_r), scale(gains.K_r, e_v))", RIGID_LAW),
    ("law-acceleration", "rigid_body", "    a = subtract(d.a,", "    a = subtract((0.0, 0.0, 0.0),", RIGID_LAW),
    ("law-attitude-error-sign", "rigid_body", "e_R = scale(-1.0, vee(Q))", "e_R = vee(Q)", RIGID_LAW),
    ("law-attitude-gains", "rigid_body", "add(scale(gains.K_R, e_R), scale(gains.K_Omega,",
     "add(scale(gains.K_Omega, e_R), scale(gains.K_R,", RIGID_LAW),
    ("law-attitude-in-the-desired-frame", "rigid_body", "Q = product(R_T, d.R)", "Q = product(d.R, R_T)", RIGID_LAW),
    ("law-desired-rate-unturned", "rigid_body", "Omega_d = apply(Q, d.Omega)", "Omega_d = d.Omega", RIGID_LAW),
    ("law-feedforward-turn", "rigid_body", "subtract(apply(Q, d.Omega_dot), cross(Omega, Omega_d))",
     "apply(Q, d.Omega_dot)", RIGID_LAW),
    ("law-feedforward-unturned", "rigid_body", "subtract(apply(Q, d.Omega_dot), cross", "subtract(d.Omega_dot, cross",
     RIGID_LAW),
    ("law-gyroscopic", "rigid_body", "add(apply(J_matrix, alpha), cross(Omega, apply(J_matrix, Omega)))",
     "apply(J_matrix, alpha)", RIGID_LAW),
    ("tone-rate", "rigid_body", "s * a * (cos(a * t) - cos(b * t))", "s * b * (cos(a * t) - cos(b * t))",
     (RIGID_MOTION, RIGID_LOOP)),
    ("tone-acceleration", "rigid_body", "s * a * (b * sin(b * t) - a * sin(a * t))",
     "s * a * (b * sin(b * t) + a * sin(a * t))", (RIGID_MOTION, RIGID_LOOP)),
    ("tone-starts-moving", "rigid_body", "s * (sin(a * t) - a / b * sin(b * t))", "s * (sin(a * t) - sin(b * t))",
     (RIGID_MOTION, RIGID_LOOP)),
    ("euler-order", "rigid_body", "sx * sy * cz - cx * sz", "sx * sy * cz + cx * sz", (RIGID_MOTION,)),
    ("euler-rate", "rigid_body", "px - pz * sy,", "px + pz * sy,", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-x", "rigid_body", "qx - qz * sy - pz * py * cy", "qx - qz * sy", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-y", "rigid_body", "+ pz * px * cy * cx", "- pz * px * cy * cx", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-z", "rigid_body", "- py * px * cx,", "+ py * px * cx,", (RIGID_MOTION, RIGID_LOOP)),
    ("weights-of-euler", "ode", "2.0 * (b2 + b3)", "(b2 + b3)", (ORDER_CONDITIONS, CONVERGENCE)),
    ("second-stage-reused", "ode", "half * b for a, b in zip(x, k2)", "half * b for a, b in zip(x, k1)",
     (ORDER_CONDITIONS, CONVERGENCE)),
    ("last-stage-at-half", "ode", "a + h * b", "a + half * b", (ORDER_CONDITIONS, CONVERGENCE)),
    ("cross-sign", "so3", "a[2] * b[0] - a[0] * b[2]", "a[0] * b[2] - a[2] * b[0]", ("check_vector_algebra",)),
    ("transpose-kept", "so3", "m[0], m[3], m[6], m[1]", "m[0], m[1], m[6], m[3]", ("check_matrix_algebra",)),
    ("vee-sign", "so3", "0.5 * (m[2] - m[6])", "0.5 * (m[6] - m[2])", ("check_vee",)),
    ("unit-rate-along-itself", "so3", "subtract(a_dot, scale(n_dot, q))", "a_dot", (UNIT,)),
    ("unit-coriolis", "so3", "scale(2.0 * n_dot, q_dot)", "scale(n_dot, q_dot)", (UNIT,)),
    ("second-axis-not-unit", "so3", "b2 = scale(1.0 / sqrt(dot(b2, b2)), b2)", "b2 = b2", ("check_orthonormalized",)),
    ("third-axis-sign", "so3", "cross(b1, b2))\n", "cross(b2, b1))\n", ("check_orthonormalized",)),
]  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize(
    ("name", "old", "new", "check"),
    [pytest.param(*m[1:4], check, id=f"{m[0]}-{check.removeprefix('check_')}") for m in MUTANTS for check in m[4]],
)
def test_a_wrong_formula_is_rejected(checks, name, old, new, check):
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        checks[check](mutant(name, old, new))


@pytest.mark.parametrize(("name", "check"), sorted({(m[1], check) for m in MUTANTS for check in m[4]}))
def test_the_unchanged_source_passes(checks, name, check):
    checks[check](mutant(name, "", ""))


def test_every_check_has_a_mutant(checks):
    assert set(checks) == {check for m in MUTANTS for check in m[4]}
