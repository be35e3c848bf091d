"""Wall times of evaluations, and the macro steps that they belong to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from cosim import Scenario
from cosim.runs.latencies import Latencies
from cosim.runs.result import Run
from cosim.system.plant import Plant

GONE = {f"components.{name}.fmu": "gone.fmu" for name in ("plant", "controller", "reference")}


def test_wall_times_have_the_times_of_their_macro_steps():
    latencies = Latencies()
    for k, seconds in enumerate([(), (0.1, 0.2), (0.3,), (), (), (0.4,), (0.5,), ()]):
        latencies.append(k, seconds)
    assert latencies.by_step() == ((0.1, 0.2), (0.3,), (0.4,), (0.5,))
    assert latencies.stretches() == ((1, 2), (5, 6))
    plant, scenario = Plant("plant", (), {}, ()), Scenario.load("pendulum", GONE)
    series = {"time": np.zeros(0)}
    run = Run(scenario, plant, "target", 0, series, "done", None, 0, 0, latencies.by_step(), 1.0, Path())
    assert run.latency_times is None  # of an earlier version
    known = replace(run, latency_steps=latencies.stretches())
    assert_allclose(known.latency_times, [0.01, 0.02, 0.05, 0.06], rtol=1e-12)
    assert replace(run, latency_steps=((0, 10**15),)).latency_times is None  # a folder that somebody has made up
