"""Actuated planar pendulum with stiction and an actuator with a dead band, and its controller. Independent of FMI.

State x = (phi [rad], phi_dot [rad/s]); phi = 0 hangs down. Input, friction and dead band are tangential forces [N], and
so is a disturbance, which is no matter of the actuator's dead band and may be left out.
The friction's static level is F_c + F_s: F_s >= 0 is the excess over Coulomb's level, so any two levels are sound.

Karnopp (1985), "Computer simulation of stick-slip friction in mechanical dynamic systems", J. Dyn. Sys. Meas. Control
107: within a band of velocity the friction balances the driving force, if it can. Armstrong-Helouvry, Dupont and
Canudas de Wit (1994), "A survey of models, analysis tools and compensation methods for the control of machines with
friction", Automatica 30: the level falls from static to Coulomb's as exp(-(phi_dot/phi_dot_s)^2), after Stribeck.

Karnopp's velocity in the band is zero; here it decays to zero within a few tau, so that der(phi) is phi_dot, and a
stuck pendulum creeps by at most phi_dot_0 tau. At fixed steps h this neither chatters nor misses the band where
h <= tau and h (F_c + F_s)/(m l) <= phi_dot_0: a slip that has to stop changes by at most the band's width, 2 phi_dot_0,
in a step; the decay is monotone; and a break-away leaves the band with the friction that it meets outside of it, but
for (phi_dot_0/phi_dot_s)^2 of F_s.
"""

from math import copysign, exp, sin


def derivative(
    x: tuple[float, float], u: tuple[float, ...], m: float = 1.75, l: float = 0.75, F_c: float = 1.0, F_s: float = 0.8,
    u_d: float = 2.0, b: float = 0.1, g: float = 9.81, phi_dot_s: float = 0.3, phi_dot_0: float = 0.01,
    tau: float = 0.01,
) -> tuple[float, float]:  # fmt: skip
    """Return the time derivative of the pendulum state.

    m l phi_ddot = F - f,  F = dead_band(u) + F_d - m g sin phi - b l phi_dot,  with the friction
    f = sign(phi_dot) (F_c + F_s exp(-(phi_dot/phi_dot_s)^2))      slip, |phi_dot| > phi_dot_0;
    f = sign(F) (F_c + F_s)                                        break-away, |F| > F_c + F_s;
    and phi_ddot = -phi_dot/tau where it sticks.

    x: (phi [rad], phi_dot [rad/s]);  u: (tangential force [N], disturbance F_d [N], zero if left out);  m: mass [kg];
    l: length [m];  F_c: Coulomb friction [N];  F_s: excess of the break-away force over it [N];
    u_d: half width of the dead band [N];  b: viscous friction [kg/s];  g: gravity [m/s^2];
    phi_dot_s: Stribeck's velocity [rad/s];
    phi_dot_0: half width of the band that sticks [rad/s];  tau: time constant in it [s];  returns (rad/s, rad/s^2).
    Karnopp (1985); Armstrong-Helouvry, Dupont and Canudas de Wit (1994), section 2.
    """
    phi, phi_dot = x
    force = dead_band(u[0], u_d) - m * g * sin(phi) - b * l * phi_dot
    if any(u[1:]):
        force += u[1]
    if abs(phi_dot) > phi_dot_0:
        friction = copysign(stribeck(phi_dot, F_c, F_s, phi_dot_s), phi_dot)
    elif abs(force) > F_c + F_s:
        friction = copysign(F_c + F_s, force)
    else:
        return (phi_dot, -phi_dot / tau)
    return (phi_dot, (force - friction) / (m * l))


def control(
    x: tuple[float, float], x_ref: tuple[float, float, float], m: float, l: float, F_c: float, F_s: float, u_d: float,
    b: float, g: float, phi_dot_s: float, Kp: float, Kd: float, phi_dot_w: float, F_w: float,
) -> float:  # fmt: skip
    """Return the input [N] of the feedback-linearising law, computed with the controller's own parameters.

    F = m l (phi_ddot_ref + Kp e1 + Kd e2) + m g sin phi + b l phi_dot + s(phi_dot_ref/phi_dot_w) f(phi_dot),
    u = F + u_d s(F/F_w),  e = x_ref - x,  f: Stribeck's curve,  s(z) = min(max(z, -1), 1).

    The friction is that of the measured speed in the direction of the desired velocity, which is free of noise and
    pushes a stuck pendulum the way it has to go. The ramps s keep u from jumping at a reversal.

    x: (phi [rad], phi_dot [rad/s]);  x_ref: (phi_ref, phi_dot_ref, phi_ddot_ref);  Kp [1/s^2], Kd [1/s]: gains of the
    linear error dynamics e1_ddot + Kd e1_dot + Kp e1 = 0, which hold away from the ramps where the parameters are true;
    phi_dot_w [rad/s], F_w [N]: half widths of the ramps;  the others as in `derivative`.
    """
    phi, phi_dot = x
    phi_ref, phi_dot_ref, phi_ddot_ref = x_ref
    acceleration = phi_ddot_ref + Kp * (phi_ref - phi) + Kd * (phi_dot_ref - phi_dot)
    friction = _ramp(phi_dot_ref, phi_dot_w) * stribeck(phi_dot, F_c, F_s, phi_dot_s)
    force = m * l * acceleration + m * g * sin(phi) + b * l * phi_dot + friction
    return force + u_d * _ramp(force, F_w)


def dead_band(u: float, u_d: float) -> float:
    """Return the force [N] of an actuator commanded u [N]: its excess over u_d, zero for |u| <= u_d."""
    return u - min(max(u, -u_d), u_d)


def stribeck(phi_dot: float, F_c: float, F_s: float, phi_dot_s: float) -> float:
    """Return the friction level [N] in slip: F_c + F_s at rest, F_c where phi_dot [rad/s] is far above phi_dot_s."""
    ratio = phi_dot / phi_dot_s
    return F_c + F_s * exp(-ratio * ratio)


def _ramp(z: float, width: float) -> float:
    """Return the sign of z, linear within the half width."""
    return min(max(z / width, -1.0), 1.0)
