"""The lines of the report on what a diagnosis has found."""

from cosim.runs.diagnosis_report import diagnosed, resting

QUIET = {"noise_ratio": 1.0, "scale": 1.0, "correlation": 0.0, "disturbance": 0.0, "is_resting": False}


def found(**channel):
    return {"channels": {"plant.der(v)": QUIET | channel}, "disturbance": 0, "disturbances": [], "unexplained": 0}


def test_of_a_model_that_explains_the_samples_there_is_nothing_to_say():
    assert diagnosed(found()) == resting(found()) == []


def test_white_residuals_that_are_larger_are_noise_and_correlated_ones_are_not():
    (noise,) = diagnosed(found(scale=4.1))
    assert noise == "the model explains plant.der(v) to 4.1 times its declared noise: multiply that by as much"
    (lacking,) = diagnosed(found(scale=4.1, correlation=0.9))
    assert lacking.startswith(
        "the model explains plant.der(v) to 4.1 times its declared noise, and the rest is smooth: the model lacks"
    )


def test_a_rest_at_the_end_is_told_whatever_has_led_to_it():
    (line,) = resting(found(is_resting=True))
    assert line == "re-tuning rests at the end: plant.der(v) left out"


def test_what_was_written_for_a_disturbance_is_undone():
    named = {"disturbance": 1, "disturbances": [{"t": 2.0, "size": {"plant.der(v)": 0.3}}]}
    (line,) = diagnosed(found() | named)
    assert line == "1 disturbance named, the last at t = 2 s (plant.der(v) 0.3): what was written for them is undone"
