"""What is set in each FMU while it runs, as a host's master would; names and arrays of FMI 3.0."""

import numpy as np

from fmu_models import build
from fmu_models.kernel.description3 import variables_of

SCRIPTS = {
    "FrictionPendulum": {"0": {"u": 4.0}, "15": {"u": -6.0, "F_d": 1.0, "tau_u": 0.05}, "30": {"u": 1.0, "F_c": 2.5}},
    "FrictionPendulumController": {"0": {"phi": 0.3}, "15": {"phi_dot_ref": 0.5, "F_s": 2.0}, "30": {"phi_dot": -0.2}},
    "FrictionPendulumControllerAdaptive": {
        "0": {"phi": 0.3}, "15": {"F_s": 2.0, "update_ready": True}, "30": {"phi_dot": -0.2},
    },
    "MagneticLevitation": {"0": {"i": 0.9, "tau_u": 0.02}, "5": {"F_d": 0.1}},
    "MagneticLevitationController": {"0": {"z": 0.011}, "15": {"v": 0.01, "m": 0.12}, "30": {"v_dot_ref": 1.0}},
    "MagneticLevitationControllerAdaptive": {
        "0": {"z": 0.011}, "15": {"z_0": 0.005, "update_ready": True}, "30": {"v": 0.01},
    },
    "MagneticLevitationReference": {"15": {"omega": 8.0}, "30": {"mean": 0.012}},
    "Pendulum": {"0": {"u": 2.0}, "15": {"u": -3.0, "m": 4.271, "tau_u": 0.1}, "30": {"u": 1.0, "F_d": 0.5}},
    "PendulumController": {"0": {"phi": 0.3}, "15": {"phi_ref": 0.5, "m": 2.0}, "30": {"phi_dot": -0.2}},
    "PendulumControllerAdaptive": {"0": {"phi": 0.3}, "15": {"m": 2.0, "update_ready": True}, "30": {"phi_dot": -0.2}},
    "PendulumReference": {"15": {"step_time": 0.35, "phi_final": 0.9}},
    "PendulumSine": {"15": {"omega_2": 4.0}, "30": {"amplitude_1": 0.3}},
    "Quadrotor": {
        "0": {"F": 13.0, "M": [0.1, 0.0, 0.0]},
        "15": {"M": [0.1, -0.2, 0.0], "m": 1.4, "J": [1.0, 2.0, 3.0], "tau_u": 0.1, "F_d": [1.0, 0.0, 2.0]},
        "30": {"M": [0.1, -0.2, 0.3]},
    },
    "QuadrotorController": {
        "0": {"r": [0.3, 0.1, 0.0], "J": [1.0, 2.0, 3.0]}, "15": {"Omega": [0.5, 0.1, -0.1]},
        "30": {"j_d": [1.0, 0.0, 0.0]},
    },
    "QuadrotorControllerAdaptive": {
        "0": {"r": [0.3, 0.1, 0.0]}, "15": {"m": 2.0, "update_ready": True}, "30": {"r": [0.4, 0.1, 0.0]},
    },
    "QuadrotorReference": {"15": {"omega": 0.8}, "30": {"smooth_yaw": True}},
    "RigidBody": {
        "0": {"F": [1.0, 0.0, -30.0], "M": [0.1, 0.0, 0.2]},
        "15": {"c": [0.1, 0.0, -0.1], "J_xy": -0.2, "k_d": 1.0},
    },
    "RigidBodyController": {"0": {"r": [0.3, 0.1, 0.0]}, "15": {"c": [0.0, 0.0, 0.1]}, "30": {"a_d": [1.0, 0.0, 0.0]}},
    "RigidBodyControllerAdaptive": {
        "0": {"r": [0.3, 0.1, 0.0]}, "15": {"m": 2.0, "update_ready": True}, "30": {"r": [0.4, 0.1, 0.0]},
    },
    "RigidBodyReference": {"15": {"omega": 0.8}, "30": {"amplitude": [0.1, 0.2, 0.3]}},
}  # fmt: skip
"""Values to set before a step, by its number."""
JUNK = {
    "FrictionPendulum": {"u": 9.0, "F_s": 3.0},
    "FrictionPendulumController": {"phi": 9.0, "u_d": 3.0},
    "FrictionPendulumControllerAdaptive": {"update_ready": True, "u_d": 3.0},
    "MagneticLevitation": {"i": 0.5, "m": 0.2},
    "MagneticLevitationController": {"z": 0.02, "K_p": 3.0},
    "MagneticLevitationControllerAdaptive": {"update_ready": True, "z_0": 0.01},
    "MagneticLevitationReference": {"omega": 9.0},
    "Pendulum": {"u": 9.0, "m": 3.0},
    "PendulumController": {"phi": 9.0, "Kp": 3.0},
    "PendulumControllerAdaptive": {"update_ready": True, "m": 3.0},
    "PendulumReference": {"step_time": 9.0},
    "PendulumSine": {"omega_1": 9.0},
    "Quadrotor": {"F": 9.0, "M": [0.0, 0.0, 9.0], "m": 3.0},
    "QuadrotorController": {"r": [0.0, 9.0, 0.0], "K_v": [3.0, 3.0, 3.0]},
    "QuadrotorControllerAdaptive": {"update_ready": True, "m": 3.0},
    "QuadrotorReference": {"amplitude_z": 9.0},
    "RigidBody": {"F": [0.0, 0.0, 9.0], "M": [0.0, 0.0, 9.0], "m": 3.0},
    "RigidBodyController": {"r": [0.0, 9.0, 0.0], "K_v": 3.0},
    "RigidBodyControllerAdaptive": {"update_ready": True, "m": 3.0},
    "RigidBodyReference": {"amplitude": [0.5, 0.5, 9.0]},
}
"""What is set between saving and restoring a state."""


def values_of(fmi, name, values):
    """Return values of FMI 3.0 variables for that version: in 2.0 each element has its own name."""
    if fmi == 3:
        return values
    members = {a.name: [m.name for m in a.members] for a in variables_of(build.MODELS[name].variables)}
    return {
        element: x
        for variable, value in values.items()
        for element, x in zip(members[variable], np.ravel(value).tolist(), strict=True)
    }


def script_of(fmi, name):
    """Return the model's script for that version."""
    return {step: values_of(fmi, name, values) for step, values in SCRIPTS[name].items()}
