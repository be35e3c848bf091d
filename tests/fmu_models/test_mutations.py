"""Each oracle of the physics rejects wrong formulas. Every check of oracles.py is here at least once."""

import numpy as np

from tests.fmu_models import oracles
from tests.mutation import checks_of, mutation_tests


def on_samples(check, *sizes):
    """The check of a property with arguments of these sizes (0: a number), on twenty random samples."""

    def run(module):
        rng = np.random.default_rng(0)
        for _ in range(20):
            arguments = [rng.normal(0, 1, n or None) for n in sizes]
            check(module, *(float(a) if np.ndim(a) == 0 else tuple(map(float, a)) for a in arguments))

    return run


def orthonormalized(module):
    rng = np.random.default_rng(0)
    for _ in range(20):
        oracles.check_orthonormalized(module, rng.normal(0, 1, 3), rng.uniform(-0.05, 0.05, 9))


def convergence(module):
    oracles.check_order_of_convergence(module, lambda x: (x[1], -np.sin(x[0])), (1.0, 0.5), 3.0, (80, 160))


CHECKS = checks_of(oracles) | {
    "check_vector_algebra": on_samples(oracles.check_vector_algebra, 3, 3, 0),
    "check_matrix_algebra": on_samples(oracles.check_matrix_algebra, 9, 9, 3),
    "check_vee": on_samples(oracles.check_vee, 9, 3),
    "check_unit_derivatives": on_samples(oracles.check_unit_derivatives, 3, 3, 3),
    "check_orthonormalized": orthonormalized,
    "check_order_of_convergence": convergence,
}
"""All the checks by name, as functions of the module alone."""

PENDULUM = "fmu_models.pendulum.equations"
QUADROTOR = "fmu_models.quadrotor.equations"
TRAJECTORIES = "fmu_models.quadrotor.trajectory"
RIGID_BODY = "fmu_models.rigid_body.equations"
MAGNET = "fmu_models.magnetic_levitation.equations"
REFERENCES = "fmu_models.kernel.references"
ODE = "fmu_models.kernel.ode"
SO3 = "fmu_models.kernel.so3"

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

PENDULUM_PUSHED = "check_pendulum_disturbance_and_dry_friction_against_mujoco"
PENDULUM_STOPS = "check_pendulum_dry_friction_stops_it"
BODY_PUSHED = "check_quadrotor_disturbance_and_drag_against_mujoco"
BODY_FALL = "check_quadrotor_terminal_velocity"
RIGID_PUSHED = "check_rigid_body_disturbance_and_drag_against_mujoco"
RIGID_FALL = "check_rigid_body_terminal_velocity"
MAGNET_FORCE = "check_magnet_derivative_is_that_of_the_co_energy"
MAGNET_ENERGY = "check_magnet_keeps_its_energy_at_constant_current"
MAGNET_FALL = "check_magnet_terminal_velocity"
MAGNET_LOOP = "check_magnet_closed_loop_error"
MAGNET_LIMITS = "check_magnet_current_is_limited"

BODY = (BODY_MUJOCO, BODY_ROTORPY)
LAW = (ATTITUDE_ERROR, POSITION_LOOP)
RIGID = (RIGID_MUJOCO, RIGID_BALANCE)
RIGID_LAW = (RIGID_ERRORS, RIGID_LOOP)

MUTANTS = [
    # id, module, old, new, the checks that must reject it
    ("gravity-up", PENDULUM, "-g / l * sin(phi) -", "g / l * sin(phi) -",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY, PENDULUM_SWING, PENDULUM_LOOP)),
    ("gravity-without-length", PENDULUM, "-g / l * sin(phi) -", "-g * sin(phi) -", (PENDULUM_MUJOCO, PENDULUM_SWING)),
    ("small-angle", PENDULUM, "-g / l * sin(phi) -", "-g / l * phi -", (PENDULUM_MUJOCO, PENDULUM_SWING)),
    ("friction-drives", PENDULUM, "- b / m * phi_dot", "+ b / m * phi_dot", (PENDULUM_MUJOCO, PENDULUM_ENERGY)),
    ("friction-without-mass", PENDULUM, "- b / m * phi_dot", "- b * phi_dot", (PENDULUM_MUJOCO, PENDULUM_LOOP)),
    ("friction-of-a-torque", PENDULUM, "- b / m * phi_dot", "- b / (m * l**2) * phi_dot",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY)),
    ("input-is-a-torque", PENDULUM, "force / (m * l))", "force / (m * l**2))",
     (PENDULUM_MUJOCO, PENDULUM_ENERGY, PENDULUM_LOOP)),
    ("control-torque", PENDULUM, "m * l * (Kp * e1", "m * l**2 * (Kp * e1", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-gravity-sign", PENDULUM, "m * l * (g / l", "-m * l * (g / l", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-friction-sign", PENDULUM, "+ b / m * phi_dot", "- b / m * phi_dot", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-error-sign", PENDULUM, "x_ref[1] - phi_dot", "phi_dot - x_ref[1]", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("control-gains-swapped", PENDULUM, "Kp * e1 + Kd * e2", "Kd * e1 + Kp * e2", (PENDULUM_CONTROL, PENDULUM_LOOP)),
    ("disturbance-against", PENDULUM, "u[0] + u[1] if", "u[0] - u[1] if", (PENDULUM_PUSHED,)),
    ("disturbance-lost", PENDULUM, "u[0] + u[1] if", "u[0] if", (PENDULUM_PUSHED,)),
    ("dry-friction-drives", PENDULUM, "force -= F_c", "force += F_c", (PENDULUM_PUSHED, PENDULUM_STOPS)),
    ("dry-friction-of-the-rate", PENDULUM, "tanh(l * phi_dot / SLIDING)", "tanh(phi_dot / SLIDING)",
     (PENDULUM_PUSHED,)),
    ("dry-friction-is-viscous", PENDULUM, "tanh(l * phi_dot / SLIDING)", "(l * phi_dot / SLIDING)",
     (PENDULUM_PUSHED, PENDULUM_STOPS)),
    ("disturbance-without-mass", QUADROTOR, "a_y + u[5] / m", "a_y + u[5]", (BODY_PUSHED, BODY_FALL)),
    ("disturbance-of-the-wrong-axis", QUADROTOR, "a_z + u[6] / m", "a_z + u[5] / m", (BODY_PUSHED, BODY_FALL)),
    ("disturbing-moment-against", QUADROTOR,
     "a_z + u[6] / m\n        M_x, M_y, M_z = M_x + u[7], M_y + u[8], M_z + u[9]",
     "a_z + u[6] / m\n        M_x, M_y, M_z = M_x + u[7], M_y - u[8], M_z + u[9]", (BODY_PUSHED,)),
    ("drag-drives", QUADROTOR, "a_z - k_d / m * vz", "a_z + k_d / m * vz", (BODY_PUSHED, BODY_FALL)),
    ("drag-without-mass", QUADROTOR, "a_x - k_d / m * vx", "a_x - k_d * vx", (BODY_PUSHED, BODY_FALL)),
    ("thrust-down", QUADROTOR, "    a = F / m\n", "    a = -F / m\n", (*BODY, BODY_BALANCE, POSITION_LOOP)),
    ("thrust-without-mass", QUADROTOR, "    a = F / m\n", "    a = F\n", (*BODY, BODY_BALANCE)),
    ("thrust-along-third-row", QUADROTOR, "-a * r13, -a * r23, g", "-a * r31, -a * r32, g", (*BODY, BODY_BALANCE)),
    ("gravity-up-z", QUADROTOR, "g - a * r33", "-g - a * r33", (*BODY, BODY_BALANCE)),
    ("rotation-the-other-way", QUADROTOR, "r12 * r - r13 * q, r13 * p - r11 * r, r11 * q - r12 * p",
     "r13 * q - r12 * r, r11 * r - r13 * p, r12 * p - r11 * q", (*BODY, BODY_BALANCE)),
    ("rates-in-the-world", QUADROTOR, "r22 * r - r23 * q,", "r31 * p - r11 * r,", (*BODY, BODY_BALANCE)),
    ("gyroscopic-sign", QUADROTOR, "(M_x - (J_z - J_y) * q * r)", "(M_x + (J_z - J_y) * q * r)",
     (*BODY, BODY_BALANCE)),
    ("gyroscopic-none", QUADROTOR, "(M_y - (J_x - J_z) * p * r)", "M_y", (*BODY, BODY_BALANCE)),
    ("inertia-of-the-wrong-axis", QUADROTOR, "(J_y - J_x) * p * q) / J_z", "(J_y - J_x) * p * q) / J_y",
     (*BODY, BODY_BALANCE)),
    ("heading-mirrored", QUADROTOR, "h = (c, s, 0.0)", "h = (c, -s, 0.0)", (DESIRED, CONTROL_ROTORPY, POSITION_LOOP)),
    ("third-axis-up", QUADROTOR, "unit_derivatives(scale(-1.0, A), scale(-1.0, A_dot), scale(-1.0, A_ddot))",
     "unit_derivatives(A, A_dot, A_ddot)", (DESIRED, CONTROL_ROTORPY)),
    ("yaw-rate-unused", QUADROTOR, "h_dot = (-psi_dot * s, psi_dot * c, 0.0)", "h_dot = (0.0, 0.0, 0.0)",
     (DESIRED, ATTITUDE_ERROR, POSITION_LOOP)),
    ("yaw-centripetal-none", QUADROTOR, "-psi_ddot * s - psi_dot**2 * c", "-psi_ddot * s", (DESIRED, *LAW)),
    ("second-product-rule", QUADROTOR, "scale(2.0, cross(b3_dot, h_dot))", "cross(b3_dot, h_dot)", (DESIRED, *LAW)),
    ("third-product-rule", QUADROTOR, "scale(2.0, cross(b2_dot, b3_dot))", "cross(b2_dot, b3_dot)", (DESIRED, *LAW)),
    ("gravity-in-the-law", QUADROTOR, "d.a[2] - g)", "d.a[2] + g)", (*LAW, CONTROL_ROTORPY)),
    ("thrust-of-z-up", QUADROTOR, "    F = -dot(A, b3)\n", "    F = dot(A, b3)\n", (*LAW, CONTROL_ROTORPY)),
    ("reference-turn-only", QUADROTOR, "A_dot = _feedback(gains, e_v, e_a, m, d.j)", "A_dot = scale(m, d.j)", LAW),
    ("reference-turn-only-second", QUADROTOR, "A_ddot = _feedback(gains, e_a, e_j, m, d.s)", "A_ddot = scale(m, d.s)",
     LAW),
    ("acceleration-without-thrust", QUADROTOR, "add(scale(F / m, b3), d.a)", "d.a", LAW),
    ("acceleration-without-gravity", QUADROTOR, "subtract((0.0, 0.0, g), add(", "subtract((0.0, 0.0, 0.0), add(",
     LAW),
    ("thrust-direction-held", QUADROTOR, "add(scale(F_dot / m, b3), scale(F / m, b3_dot))", "scale(F_dot / m, b3)",
     LAW),
    ("thrust-held", QUADROTOR, "F_dot = -dot(A_dot, b3) - dot(A, b3_dot)", "F_dot = 0.0", LAW),
    ("thrust-rate-without-turn", QUADROTOR, "F_dot = -dot(A_dot, b3) - dot(A, b3_dot)", "F_dot = -dot(A_dot, b3)",
     (ATTITUDE_ERROR,)),  # where R = R_d, A is along b3 and the dropped term is nil
    ("turn-of-the-thrust-axis", QUADROTOR, "(Omega[1], -Omega[0], 0.0)", "(-Omega[1], Omega[0], 0.0)", LAW),
    ("attitude-error-sign", QUADROTOR, "e_R = scale(-1.0, vee(Q))", "e_R = vee(Q)",
     (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("attitude-error-twice", QUADROTOR, "e_R = scale(-1.0, vee(Q))", "e_R = scale(-2.0, vee(Q))",
     (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("attitude-error-in-the-desired-frame", QUADROTOR, "Q = product(transpose(R), desired.R)",
     "Q = product(desired.R, transpose(R))", (ATTITUDE_ERROR, CONTROL_ROTORPY)),
    ("desired-rate-nil", QUADROTOR, "Omega_d = apply(Q, desired.Omega)", "Omega_d = (0.0, 0.0, 0.0)", LAW),
    ("desired-rate-unturned", QUADROTOR, "Omega_d = apply(Q, desired.Omega)", "Omega_d = desired.Omega",
     (ATTITUDE_ERROR,)),  # where R = R_d nothing is to be turned
    ("feedforward-sign", QUADROTOR, "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = subtract(apply(Q, desired.Omega_dot), cross(Omega, Omega_d))", LAW),
    ("feedforward-without-turn", QUADROTOR,
     "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = scale(-1.0, apply(Q, desired.Omega_dot))", (ATTITUDE_ERROR,)),  # nil where Omega = Omega_d
    ("feedforward-without-acceleration", QUADROTOR,
     "feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))",
     "feedforward = cross(Omega, Omega_d)", LAW),
    ("feedforward-without-inertia", QUADROTOR, "multiply(J, feedforward)", "feedforward", LAW),
    ("gyroscopic-compensation", QUADROTOR, "cross(Omega, multiply(J, Omega))", "cross(multiply(J, Omega), Omega)",
     (*LAW, CONTROL_ROTORPY)),
    ("feedback-of-position", QUADROTOR, "-K_r[1] * e[1]", "K_r[1] * e[1]", (*LAW, CONTROL_ROTORPY)),
    ("feedback-of-the-wrong-axis", QUADROTOR, "K_v[2] * e_dot[2]", "K_v[0] * e_dot[2]", (*LAW, CONTROL_ROTORPY)),
    ("feedback-without-mass", QUADROTOR, "m * a[0]", "a[0]", (*LAW, CONTROL_ROTORPY)),
    ("jerk-sign", REFERENCES, "-(omega**3) * c", "omega**3 * c", (SINUSOID,)),
    ("snap-order", REFERENCES, "omega**4 * s", "omega**3 * s", (SINUSOID,)),
    ("velocity-phase", REFERENCES, "(s, omega * c,", "(s, omega * s,", (SINUSOID,)),
    ("x-at-single-rate", TRAJECTORIES, "sinusoid(t, a1, 2.0 * omega)", "sinusoid(t, a1, omega)", (TRAJECTORY,)),
    ("z-amplitude", TRAJECTORIES, "sinusoid(t, a3, omega)", "sinusoid(t, a2, omega)", (TRAJECTORY,)),
    ("yaw-of-x-over-y", TRAJECTORIES, "    psi = atan2(a2, p)\n", "    psi = atan2(p, a2)\n",
     (TRAJECTORY, YAW_RATES, PAPER_YAW)),
    ("yaw-rate-sign", TRAJECTORIES, "psi_dot = -a2 * p_dot / n", "psi_dot = a2 * p_dot / n", (YAW_RATES,)),
    ("yaw-acceleration-quotient", TRAJECTORIES, "2.0 * a2 * p * p_dot**2", "a2 * p * p_dot**2", (YAW_RATES,)),
    ("yaw-never-jumps", TRAJECTORIES, "psi -= pi", "psi -= 0.0", (PAPER_YAW,)),
    ("yaw-jumps-by-half", TRAJECTORIES, "psi -= pi", "psi -= pi / 2", (TRAJECTORY, PAPER_YAW)),
    ("yaw-jumps-up", TRAJECTORIES, "psi -= pi", "psi += pi", (PAPER_YAW,)),
    ("yaw-limit-from-the-left", TRAJECTORIES, "(sin(omega * t) or cos(omega * t)) < 0.0",
     "(sin(omega * t) or -cos(omega * t)) < 0.0", (PAPER_YAW,)),
    ("moment-arm-sign", RIGID_BODY, "subtract(M, cross(c, F))", "add(M, cross(c, F))",
     (*RIGID, RIGID_LOOP)),
    ("moment-about-the-centre", RIGID_BODY, "M_c = subtract(M, cross(c, F))", "M_c = M", (*RIGID, RIGID_LOOP)),
    ("euler-gyroscopic-sign", RIGID_BODY, "subtract(M_c, cross(Omega, apply(matrix(J), Omega)))",
     "add(M_c, cross(Omega, apply(matrix(J), Omega)))", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("euler-gyroscopic-none", RIGID_BODY, "subtract(M_c, cross(Omega, apply(matrix(J), Omega)))", "M_c",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("acceleration-of-the-centre", RIGID_BODY, "a = apply(x[6:15], subtract(scale(1.0 / m, F), "
     "_lever(c, Omega, Omega_dot)))", "a = apply(x[6:15], scale(1.0 / m, F))", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("lever-sign", RIGID_BODY, "subtract(scale(1.0 / m, F), _lever", "add(scale(1.0 / m, F), _lever",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("lever-without-centripetal", RIGID_BODY, "return add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))",
     "return cross(Omega_dot, c)", (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),  # the same slip in the law makes up for it
    ("lever-without-acceleration", RIGID_BODY, "return add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))",
     "return cross(Omega, cross(Omega, c))", (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),
    ("body-gravity-up", RIGID_BODY, "g + a[2],", "-g + a[2],", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("force-in-the-world", RIGID_BODY, "    a = apply(x[6:15], sub", "    a = apply(transpose(x[6:15]), sub",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("body-turns-the-other-way", RIGID_BODY, "r22 * r - r23 * q,", "r23 * q - r22 * r,",
     (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("products-swapped", RIGID_BODY, "(xx, xy, xz, xy, yy, yz, xz, yz, zz)", "(xx, xz, xy, xz, yy, yz, xy, yz, zz)",
     (*RIGID, RIGID_FLIGHT, RIGID_ERRORS)),
    ("products-as-sums", RIGID_BODY, "    xx, yy, zz, xy, xz, yz = J\n    a_xx",
     "    xx, yy, zz, xy, xz, yz = *J[:3], *scale(-1.0, J[3:])\n    a_xx", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("cofactor-sign", RIGID_BODY, "xz * yz - xy * zz", "xy * zz - xz * yz", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("determinant-term", RIGID_BODY, "+ xz * a_xz\n", "- xz * a_xz\n", (*RIGID, RIGID_FLIGHT, RIGID_LOOP)),
    ("law-moment-arm-sign", RIGID_BODY, "cross(Omega, apply(J_matrix, Omega))), cross(c, F))",
     "cross(Omega, apply(J_matrix, Omega))), cross(F, c))", RIGID_LAW),
    ("law-without-lever", RIGID_BODY, "_lever(c, Omega, alpha)", "(0.0, 0.0, 0.0)", RIGID_LAW),
    ("law-lever-of-the-rates-alone", RIGID_BODY, "_lever(c, Omega, alpha)", "_lever(c, Omega, (0.0, 0.0, 0.0))",
     RIGID_LAW),
    ("law-gravity", RIGID_BODY, "subtract(a, (0.0, 0.0, g))", "add(a, (0.0, 0.0, g))", RIGID_LAW),
    ("law-force-in-the-world", RIGID_BODY, "apply(R_T, subtract(a,", "apply(transpose(R_T), subtract(a,", RIGID_LAW),
    ("law-position-feedback", RIGID_BODY, "add(scale(gains.K_r, e_r), scale(gains.K_v, e_v))",
     "add(scale(gains.K_v, e_r), scale(gains.K_r, e_v))", RIGID_LAW),
    ("law-acceleration", RIGID_BODY, "    a = subtract(d.a,", "    a = subtract((0.0, 0.0, 0.0),", RIGID_LAW),
    ("law-attitude-error-sign", RIGID_BODY, "e_R = scale(-1.0, vee(Q))", "e_R = vee(Q)", RIGID_LAW),
    ("law-attitude-gains", RIGID_BODY, "add(scale(gains.K_R, e_R), scale(gains.K_Omega,",
     "add(scale(gains.K_Omega, e_R), scale(gains.K_R,", RIGID_LAW),
    ("law-attitude-in-the-desired-frame", RIGID_BODY, "Q = product(R_T, d.R)", "Q = product(d.R, R_T)", RIGID_LAW),
    ("law-desired-rate-unturned", RIGID_BODY, "Omega_d = apply(Q, d.Omega)", "Omega_d = d.Omega", RIGID_LAW),
    ("law-feedforward-turn", RIGID_BODY, "subtract(apply(Q, d.Omega_dot), cross(Omega, Omega_d))",
     "apply(Q, d.Omega_dot)", RIGID_LAW),
    ("law-feedforward-unturned", RIGID_BODY, "subtract(apply(Q, d.Omega_dot), cross", "subtract(d.Omega_dot, cross",
     RIGID_LAW),
    ("law-gyroscopic", RIGID_BODY, "add(apply(J_matrix, alpha), cross(Omega, apply(J_matrix, Omega)))",
     "apply(J_matrix, alpha)", RIGID_LAW),
    ("tone-rate", RIGID_BODY, "s * a * (cos(a * t) - cos(b * t))", "s * b * (cos(a * t) - cos(b * t))",
     (RIGID_MOTION, RIGID_LOOP)),
    ("tone-acceleration", RIGID_BODY, "s * a * (b * sin(b * t) - a * sin(a * t))",
     "s * a * (b * sin(b * t) + a * sin(a * t))", (RIGID_MOTION, RIGID_LOOP)),
    ("tone-starts-moving", RIGID_BODY, "s * (sin(a * t) - a / b * sin(b * t))", "s * (sin(a * t) - sin(b * t))",
     (RIGID_MOTION, RIGID_LOOP)),
    ("euler-order", RIGID_BODY, "sx * sy * cz - cx * sz", "sx * sy * cz + cx * sz", (RIGID_MOTION,)),
    ("euler-rate", RIGID_BODY, "px - pz * sy,", "px + pz * sy,", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-x", RIGID_BODY, "qx - qz * sy - pz * py * cy", "qx - qz * sy", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-y", RIGID_BODY, "+ pz * px * cy * cx", "- pz * px * cy * cx", (RIGID_MOTION, RIGID_LOOP)),
    ("euler-acceleration-z", RIGID_BODY, "- py * px * cx,", "+ py * px * cx,", (RIGID_MOTION, RIGID_LOOP)),
    ("disturbance-in-the-body", RIGID_BODY, "add(F, apply(transpose(x[6:15]), u[6:9]))", "add(F, u[6:9])",
     (RIGID_PUSHED,)),
    ("disturbing-moment-in-the-world", RIGID_BODY, "add(M, u[9:12])", "add(M, apply(transpose(x[6:15]), u[9:12]))",
     (RIGID_PUSHED,)),
    ("body-drag-drives", RIGID_BODY, "F = subtract(F, apply(t", "F = add(F, apply(t", (RIGID_PUSHED, RIGID_FALL)),
    ("body-drag-in-the-body", RIGID_BODY, "subtract(F, apply(transpose(x[6:15]), scale(k_d, (vx, vy, vz))))",
     "subtract(F, scale(k_d, (vx, vy, vz)))", (RIGID_PUSHED, RIGID_FALL)),
    ("magnet-pushes", MAGNET, "g - k / m * (ratio * ratio)", "g + k / m * (ratio * ratio)",
     (MAGNET_FORCE, MAGNET_ENERGY)),
    ("magnet-of-the-first-power", MAGNET, "(ratio * ratio)", "abs(ratio)", (MAGNET_FORCE, MAGNET_ENERGY)),
    ("magnet-without-offset", MAGNET, "u[0] / (z + z_0)", "u[0] / z", (MAGNET_FORCE, MAGNET_ENERGY)),
    ("magnet-without-mass", MAGNET, "k / m * (ratio", "k * (ratio", (MAGNET_FORCE, MAGNET_ENERGY)),
    ("push-up", MAGNET, "v_dot += u[1] / m", "v_dot -= u[1] / m", (MAGNET_FORCE, MAGNET_FALL)),
    ("ball-drag-without-mass", MAGNET, "k_d / m * v", "k_d * v", (MAGNET_FORCE, MAGNET_FALL)),
    ("current-without-offset", MAGNET, "max(z + z_0, 0.0)", "max(z, 0.0)", (MAGNET_LOOP, MAGNET_LIMITS)),
    ("current-of-the-inverse-mass", MAGNET, "sqrt(m / k * max", "sqrt(k / m * max", (MAGNET_LOOP, MAGNET_LIMITS)),
    ("current-without-root", MAGNET, "sqrt(m / k * max(pull, 0.0))", "(m / k * max(pull, 0.0))",
     (MAGNET_LOOP, MAGNET_LIMITS)),
    ("gap-error-sign", MAGNET, "K_p * (z_ref - z)", "K_p * (z - z_ref)", (MAGNET_LOOP, MAGNET_LIMITS)),
    ("rate-error-sign", MAGNET, "K_d * (v_ref - v)", "K_d * (v - v_ref)", (MAGNET_LOOP,)),
    ("magnet-without-feedforward", MAGNET, "pull = g - v_dot_ref - K_p", "pull = g - K_p", (MAGNET_LOOP,)),
    ("current-unlimited", MAGNET, "max(pull, 0.0)), i_max)", "max(pull, 0.0)), 100.0)", (MAGNET_LIMITS,)),
    ("weights-of-euler", ODE, "2.0 * (b2 + b3)", "(b2 + b3)", (ORDER_CONDITIONS, CONVERGENCE)),
    ("second-stage-reused", ODE, "half * b for a, b in zip(x, k2)", "half * b for a, b in zip(x, k1)",
     (ORDER_CONDITIONS, CONVERGENCE)),
    ("last-stage-at-half", ODE, "a + h * b", "a + half * b", (ORDER_CONDITIONS, CONVERGENCE)),
    ("cross-sign", SO3, "a[2] * b[0] - a[0] * b[2]", "a[0] * b[2] - a[2] * b[0]", ("check_vector_algebra",)),
    ("transpose-kept", SO3, "m[0], m[3], m[6], m[1]", "m[0], m[1], m[6], m[3]", ("check_matrix_algebra",)),
    ("vee-sign", SO3, "0.5 * (m[2] - m[6])", "0.5 * (m[6] - m[2])", ("check_vee",)),
    ("unit-rate-along-itself", SO3, "subtract(a_dot, scale(n_dot, q))", "a_dot", (UNIT,)),
    ("unit-coriolis", SO3, "scale(2.0 * n_dot, q_dot)", "scale(n_dot, q_dot)", (UNIT,)),
    ("second-axis-not-unit", SO3, "b2 = scale(1.0 / sqrt(dot(b2, b2)), b2)", "b2 = b2", ("check_orthonormalized",)),
    ("third-axis-sign", SO3, "cross(b1, b2))\n", "cross(b2, b1))\n", ("check_orthonormalized",)),
]  # fmt: skip

TestMutants = mutation_tests(MUTANTS, CHECKS)
