from fmu_models import pendulum


def test_derivative_is_that_of_a_damped_hinge_in_mujoco(oracles):
    oracles.check_pendulum_derivative_against_mujoco(pendulum)


def test_control_is_mujocos_inverse_dynamics_of_the_linear_error_law(oracles):
    oracles.check_pendulum_control_against_mujoco_inverse_dynamics(pendulum)


def test_a_disturbance_and_dry_friction_are_forces_at_the_tip(oracles):
    oracles.check_pendulum_disturbance_and_dry_friction_against_mujoco(pendulum)


def test_dry_friction_stops_it_where_it_should(oracles):
    oracles.check_pendulum_dry_friction_stops_it(pendulum)


def test_energy_changes_by_the_power_of_the_input_and_of_friction(oracles):
    oracles.check_pendulum_energy_balance(pendulum)


def test_undamped_swing_is_the_elliptic_function_and_keeps_its_energy(oracles):
    oracles.check_pendulum_swing_against_elliptic_functions(pendulum)


def test_closed_loop_error_is_linear_where_the_parameters_are_true(oracles):
    oracles.check_pendulum_closed_loop_error(pendulum)


def test_default_parameters_are_the_papers():
    x, u = (1.0, 0.5), (2.0,)
    assert pendulum.derivative(x, u) == pendulum.derivative(x, u, m=1.75, l=0.75, b=0.1, g=9.81, F_c=0.0)
