"""Glucose and insulin by Bergman's minimal model, in a diabetic with a pump.

Bergman, Phillips and Cobelli (1981), J. Clinical Investigation 68; Fisher (1991), IEEE Trans. Biomedical Engineering
38. A second of the run is a minute of the patient. State x = (G [mg/dl], Z [mU/l], I [mU/l]): glucose, insulin where it
acts, and in the plasma. The load is glucose from a meal [mg/(dl min)].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, limited, total, wave

FASTING = 200.0
"""Glucose without any insulin [mg/dl]."""
ACTION = 0.025
"""Rate at which the insulin gets where it acts [1/min]."""
CLEARANCE = 0.09
"""Rate at which it leaves the plasma [1/min]."""
POLE = 0.06
"""Three poles of the error at -0.06 per minute."""
MOST = 30.0
"""Largest infusion [mU/(l min)]."""


def derivative(x: Values, u: Values, S: float, p: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    G_dot = p (200 - G) - S Z G + load,  Z_dot = 0.025 (I - Z),  I_dot = u - 0.09 I

    u: (infusion by volume [mU/(l min)]);  S: sensitivity [l/(mU min)];  p: effectiveness of glucose itself [1/min].
    """
    glucose, Z, insulin = x
    return (p * (FASTING - glucose) - S * Z * glucose + load, ACTION * (insulin - Z), u[0] - CLEARANCE * insulin)


def control(x: Values, reference: Values, S: float, p: float) -> Values:
    """Return the infusion that makes glucose follow to its third derivative: feedback linearisation."""
    glucose, Z, _ = x
    loss = p + S * Z
    rate, Z_dot, I_free, _ = *derivative(x, (0.0,), S, p), 0.0
    curvature = -loss * rate - S * Z_dot * glucose
    gains, actual = (POLE**3, 3.0 * POLE**2, 3.0 * POLE), (glucose, rate, curvature)
    wanted = reference[3] + sum(k * (r - y) for k, r, y in zip(gains, reference, actual))
    free = -loss * curvature - 2.0 * S * Z_dot * rate - S * glucose * ACTION * (I_free - Z_dot)
    return (limited((free - wanted) / (S * glucose * ACTION), 0.0, MOST),)


def reference(t: float) -> Values:
    """Return the desired glucose to its third derivative."""
    value, *rates = total(wave(t, 15.0, 0.015, n=3), wave(t, 4.0, 0.04, n=3))
    return (125.0 + value, *rates)


def _start(S: float, p: float) -> Values:
    G, rate, curvature, _ = reference(0.0)
    Z = (p * (FASTING - G) - rate) / (S * G)
    Z_dot = (-(p + S * Z) * rate - curvature) / (S * G)
    return (G, Z, Z + Z_dot / ACTION)


_BEGIN = _start(5.2e-4, 0.02)
_SAME = "there is no motion"
PLANT = ForeignPlant(
    name="glucose",
    title="Glucose and insulin of a diabetic",
    parameters=(
        Estimated("S", "1/s", 5.2e-4, 3.7e-4, "Sensitivity to insulin, by minute and mU/l"),
        Estimated("p", "1/s", 0.02, 0.026, "Effectiveness of glucose, by minute"),
    ),
    states=(
        Signal("G", None, "Glucose, in mg/dl", _BEGIN[0]),
        Signal("Z", None, "Insulin where it acts, in mU/l", _BEGIN[1]),
        Signal("I", None, "Insulin in the plasma, in mU/l", _BEGIN[2]),
    ),
    controls=(Signal("u", None, "Infusion, in mU/l by minute"),),
    references=(
        Signal("G_ref", None, "Desired glucose, in mg/dl"),
        Signal("G_dot_ref", None, "Its derivative"),
        Signal("G_ddot_ref", None, "Its second derivative"),
        Signal("G_dddot_ref", None, "Its third derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"G": "G_ref"},
    noise={"G": 0.02},
    step=1.0,
    divergence=70.0,
    rate=0.038,
    limit=3.2,
    omitted={"viscous": _SAME, "dry": _SAME},
)
