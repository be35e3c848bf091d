"""What a model lacks is told from what is wrong in it, on a mass that is simulated in closed loop."""

import numpy as np
import pytest

from cosim.authoring.model_comparison import Step, differences

STATES = ("s", "v")
H, MASS, SPRING = 0.01, 2.0, 8.0


def plant(friction=0.0, late=0, n=100):
    """Macro steps of m s'' = u - c s - friction(v) that follows s = t, from rest of the acceleration, by a PD law."""
    x, steps, asked = np.array([0.0, 1.0]), [], []
    for k in range(n):
        t = k * H
        asked.append(SPRING * t + 30.0 * (t + 0.02 * np.sin(9.0 * t) - x[0]) + 10.0 * (1.0 - x[1]))
        u = asked[max(k - late, 0)]
        before = x
        for _ in range(20):
            a = (u - SPRING * x[0] - friction * x[1]) / MASS
            x = x + H / 20 * np.array([x[1] + 0.5 * H / 20 * a, a])
        steps.append(Step(t + H, (tuple(before), tuple(x)), (asked[-1],), np.array([MASS]), {}))
    return steps


def right(x, u, theta):
    s, v = x
    return v, (u[0] - SPRING * s) / theta[0]


def found(model, steps):
    return {d.state: d for d in differences(model, STATES, steps, H, {})}


def test_a_right_model_differs_nowhere():
    assert not found(right, plant())


@pytest.mark.parametrize("friction", [0.5, 3.0, 10.0])
def test_friction_that_a_model_lacks_is_no_mistake_although_the_acceleration_begins_at_zero(friction):
    (only,) = found(right, plant(friction)).values()
    assert only.state == "v"
    assert not only.is_mistake
    assert "may stay out; otherwise add it" in only.why


MISTAKES = {
    "sign": lambda x, u, theta: (x[1], -right(x, u, theta)[1]),
    "sign of the input": lambda x, u, theta: right(x, (-u[0],), theta),
    "unit of the derivative": lambda x, u, theta: (x[1], np.rad2deg(right(x, u, theta)[1])),
    "unit of the parameter": lambda x, u, theta: right(x, u, theta / 1000),
    "factor of three": lambda x, u, theta: right(x, u, 3 * theta),
    "states": lambda x, u, theta: right(x[::-1], u, theta),
    "states and derivatives": lambda x, u, theta: right(x[::-1], u, theta)[::-1],
}


@pytest.mark.parametrize("friction", [0.0, 3.0], ids=["all known", "friction lacks"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_whatever_else_lacks(mistake, friction):
    told = found(MISTAKES[mistake], plant(friction)).values()
    assert any(d.is_mistake for d in told)
    if mistake.startswith("states") and not friction:
        assert all("it fits with s and v exchanged; the model's x is s, v" in d.why for d in told)


def test_a_wrong_factor_is_told():
    told = found(MISTAKES["factor of three"], plant())["v"]
    assert "the FMU's changes by 3 times the model's from step to step: look at signs, units" in told.why


def test_inputs_that_arrive_late_are_told_and_no_mistake():
    told = found(right, plant(late=3))["v"]
    assert not told.is_mistake
    assert "it fits with inputs 3 macro steps late" in told.why


def test_noise_hides_a_difference():
    assert not list(differences(right, STATES, plant(0.5), H, {"v": 0.2}))
