"""Documentation of an estimator FMU: its equations, as HTML, and its icon."""

from pathlib import Path

from fmu_models.kernel.theory import Theory

THEORY = Theory(
    (
        "r<sub>i</sub>(θ) = (ẋ<sub>i</sub> − f<sub>i</sub>(x, u; θ)) / σ<sub>i</sub> at the newest samples",
        "θ̂ = arg min r(θ)<sup>T</sup> r(θ), by target-vector Bayesian optimisation or the method named at building",
    ),
    "x, u and ẋ are inputs, sampled at each step; f is the plant's model, σ the standard deviation of the noise on "
    "each derivative. The outputs are those of the step that has ended.",
    "Khan and Chatterjee (2020), algorithm 1; Uhrenholt and Jensen (2019), “Efficient Bayesian optimization for "
    "target vector estimation”.",
)
ICON = Path(__file__).with_name("icon.png")
