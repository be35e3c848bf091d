"""What each model computes, as HTML for the documentation in its FMU."""

from collections.abc import Mapping

_PENDULUM_SOURCE = (
    "Khan and Chatterjee (2020), “Online parameter estimation for safety-critical systems with Gaussian processes”, "
    "section IV-A."
)
_LEE = (
    "Lee, Leok, McClamroch (2010), “Geometric tracking control of a quadrotor UAV on SE(3)”, equations 2-5 and 15-16."
)
_FRICTION_SOURCE = (
    "Karnopp (1985), “Computer simulation of stick-slip friction in mechanical dynamic systems”; "
    "Armstrong-Helouvry, Dupont and Canudas de Wit (1994), “A survey of models, analysis tools and compensation "
    "methods for the control of machines with friction”."
)
_RIGID_SOURCE = "Featherstone (2008), “Rigid Body Dynamics Algorithms”, sections 2.13-2.15."

EQUATIONS: Mapping[str, tuple[tuple[str, ...], str, str]] = {
    "Pendulum": (
        ("φ̈ = −(g/l) sin φ − (b/m) φ̇ + u/(m l)",),
        "φ (phi) = 0 hangs down; the input u is a tangential force.",
        _PENDULUM_SOURCE,
    ),
    "PendulumController": (
        (
            "u = m l (K<sub>p</sub> e<sub>1</sub> + K<sub>d</sub> e<sub>2</sub>) + m l ((g/l) sin φ + (b/m) φ̇)",
            "e<sub>1</sub> = φ<sub>ref</sub> − φ,  e<sub>2</sub> = φ̇<sub>ref</sub> − φ̇",
        ),
        "With true parameters the error obeys ë<sub>1</sub> + K<sub>d</sub> ė<sub>1</sub> + K<sub>p</sub> e<sub>1</sub>"
        " = 0. m, l and b are what the controller believes in; they may be changed at every communication point.",
        _PENDULUM_SOURCE,
    ),
    "PendulumReference": (
        ("φ<sub>ref</sub> = phi_initial for t &lt; step_time, phi_final from then on",),
        "The desired angular velocity is zero.",
        _PENDULUM_SOURCE,
    ),
    "PendulumSine": (
        (
            "φ<sub>ref</sub> = amplitude_1 sin(omega_1 t) + amplitude_2 sin(omega_2 t)",
            "φ̇<sub>ref</sub> and φ̈<sub>ref</sub>: its exact time derivatives",
        ),
        "Two frequencies show more parameters than one.",
        "",
    ),
    "FrictionPendulum": (
        (
            "m l φ̈ = F − f,  F = u − min(max(u, −u<sub>d</sub>), u<sub>d</sub>) − m g sin φ − b l φ̇",
            "slip, |φ̇| &gt; φ̇<sub>0</sub>:  f = sign(φ̇) (F<sub>c</sub> + F<sub>s</sub> exp(−(φ̇/φ̇<sub>s</sub>)²))",
            "break-away, |F| &gt; F<sub>c</sub> + F<sub>s</sub>:  f = sign(F) (F<sub>c</sub> + F<sub>s</sub>)",
            "stick, otherwise:  φ̈ = −φ̇/τ",
        ),
        "φ (phi) = 0 hangs down. φ̇<sub>0</sub> is phi_dot_0, φ̇<sub>s</sub> is phi_dot_s, τ is tau. "
        "Keep max_step at most tau.",
        _FRICTION_SOURCE,
    ),
    "FrictionPendulumController": (
        (
            "F = m l (φ̈<sub>ref</sub> + K<sub>p</sub> e<sub>1</sub> + K<sub>d</sub> e<sub>2</sub>) + m g sin φ + b l φ̇"
            " + s(φ̇<sub>ref</sub>/φ̇<sub>w</sub>) (F<sub>c</sub> + F<sub>s</sub> exp(−(φ̇/φ̇<sub>s</sub>)²))",
            "u = F + u<sub>d</sub> s(F/F<sub>w</sub>),  s(z) = min(max(z, −1), 1)",
            "e<sub>1</sub> = φ<sub>ref</sub> − φ,  e<sub>2</sub> = φ̇<sub>ref</sub> − φ̇",
        ),
        "The ramps s keep u from jumping at a reversal.",
        _FRICTION_SOURCE,
    ),
    "Quadrotor": (
        (
            "ṙ = v",
            "v̇ = g e<sub>3</sub> − (F/m) R e<sub>3</sub>",
            "Ṙ = R [Ω]<sub>×</sub>",
            "J dΩ/dt = M − Ω × J Ω,  J = diag(J<sub>x</sub>, J<sub>y</sub>, J<sub>z</sub>)",
        ),
        "Inertial frame: z down (north-east-down). Body frame: z down, thrust along −z. R takes body to inertial "
        "vectors; Ω (Omega) and M are in body axes, and [Ω]<sub>×</sub> b = Ω × b. R is made orthogonal again after "
        "each step.",
        _LEE,
    ),
    "QuadrotorController": (
        (
            "A = −K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> e<sub>v</sub> − m g e<sub>3</sub> + m a<sub>d</sub>,"
            "  F = −A · R e<sub>3</sub>",
            "M = −K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub> + Ω × J Ω"
            " − J ([Ω]<sub>×</sub> Rᵀ R<sub>d</sub> Ω<sub>d</sub> − Rᵀ R<sub>d</sub> dΩ<sub>d</sub>/dt)",
            "R<sub>d</sub>: third axis −A/|A|, heading ψ<sub>d</sub>; Ω<sub>d</sub> and dΩ<sub>d</sub>/dt from Ȧ and Ä",
            "e<sub>r</sub> = r − r<sub>d</sub>,  e<sub>v</sub> = v − v<sub>d</sub>,"
            "  ê<sub>R</sub> = (R<sub>d</sub>ᵀ R − Rᵀ R<sub>d</sub>)/2,"
            "  e<sub>Ω</sub> = Ω − Rᵀ R<sub>d</sub> Ω<sub>d</sub>",
        ),
        "Ȧ and Ä carry the error terms, with the acceleration that the controller's own m, F and R predict. "
        "Undefined, and an error, where A = 0 or A is along the heading.",
        _LEE,
    ),
    "QuadrotorReference": (
        (
            "r<sub>d</sub> = (amplitude_x sin 2ωt, amplitude_y sin ωt, amplitude_z sin ωt), to its fourth derivative",
            "ψ<sub>d</sub> = atan2(y<sub>d</sub>, x<sub>d</sub>), or with smooth_yaw"
            " atan2(amplitude_y, 2 amplitude_x cos ωt), to its second derivative",
        ),
        "atan2 jumps by π where x<sub>d</sub> = y<sub>d</sub> = 0; the smooth branch does not. ω is omega.",
        _PENDULUM_SOURCE.replace("IV-A", "IV-B"),
    ),
    "RigidBody": (
        (
            "J dΩ/dt = M − c × F − Ω × J Ω",
            "v̇ = g e<sub>3</sub> + R (F/m − dΩ/dt × c − Ω × (Ω × c))",
            "ṙ = v,  Ṙ = R [Ω]<sub>×</sub>",
        ),
        "r and v are of the body's origin, where the wrench (F, M) acts, in body axes; c is the centre of mass from "
        "there, J the inertia about the centre of mass. Inertial frame: z down. R is made orthogonal again after each "
        "step.",
        _RIGID_SOURCE,
    ),
    "RigidBodyController": (
        (
            "a = a<sub>d</sub> − K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> e<sub>v</sub>",
            "α = Q dΩ<sub>d</sub>/dt − Ω × Q Ω<sub>d</sub> − K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub>,"
            "  Q = Rᵀ R<sub>d</sub>",
            "F = m (Rᵀ (a − g e<sub>3</sub>) + α × c + Ω × (Ω × c))",
            "M = J α + Ω × J Ω + c × F",
        ),
        "With true parameters ë<sub>r</sub> = −K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> ė<sub>r</sub> and "
        "ė<sub>Ω</sub> = −K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub>.",
        "Siciliano et al. (2009), “Robotics”, section 8.5.2; errors of attitude: Lee et al. (2010).",
    ),
    "RigidBodyReference": (
        (
            "q(t) = s (sin at − (a/b) sin bt) for each of x, y, z, roll, pitch and yaw, s being its amplitude",
            "R<sub>d</sub> = R<sub>z</sub>(yaw) R<sub>y</sub>(pitch) R<sub>x</sub>(roll), and its exact"
            " Ω<sub>d</sub> and dΩ<sub>d</sub>/dt",
        ),
        "a and b are multiples of omega that differ from coordinate to coordinate. The motion starts at rest and shows "
        "all ten parameters.",
        "Diebel (2006), “Representing attitude”, equations 67 and 74.",
    ),
    "Estimator": (
        (
            "r<sub>i</sub>(θ) = (ẋ<sub>i</sub> − f<sub>i</sub>(x, u; θ)) / σ<sub>i</sub> at the newest samples",
            "θ̂ = arg min r(θ)<sup>T</sup> r(θ), by target-vector Bayesian optimisation or the method named at building",
        ),
        "x, u and ẋ are inputs, sampled at each step; f is the plant's model, σ the standard deviation of the noise on "
        "each derivative. The outputs are those of the step that has ended.",
        "Khan and Chatterjee (2020), algorithm 1; Uhrenholt and Jensen (2019), “Efficient Bayesian optimization for "
        "target vector estimation”.",
    ),
}
"""By model: the equations, what their letters mean beyond the table of variables, and the source."""


def described(name: str) -> tuple[tuple[str, ...], str, str]:
    """Equations, notes and source of the model of that name, or of the kind that its name ends with."""
    if name.endswith("Estimator"):
        return EQUATIONS["Estimator"]
    equations, notes, source = EQUATIONS[name.removesuffix("Adaptive")]
    if name.endswith("Adaptive"):
        notes += " What an estimator finds is an input here, and used from a step on at which update_ready is true."
    return equations, notes, source
