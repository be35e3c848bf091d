"""Our own FMUs say why they fail, in the exception's own words."""

import math
from pathlib import Path

import pytest

from cosim.errors import SlaveError
from cosim.fmi.archive import fmu_to_load, read_description, unpack
from cosim.fmi.value_buffers import ScalarVariable
from cosim.slaves.process import FmuProcess
from cosim.slaves.slave import Slave, open_slave
from fmu_models.build import build

pytestmark = pytest.mark.fmu

NO_ATTITUDE = "ValueError: desired attitude undefined: the commanded force is zero or along the heading"


@pytest.fixture(scope="module")
def controller(tmp_path_factory) -> Path:
    return build("QuadrotorController", tmp_path_factory.mktemp("controller"))


def bind(slave: Slave) -> None:
    slave.bind(inputs=["a_d_z"], tunables=["g"], outputs=["F", "M_x"])


def test_weightless_hover_has_no_desired_attitude(controller):
    with open_slave(controller, "controller") as slave:
        bind(slave)
        with pytest.raises(SlaveError) as caught:
            slave.initialize({"g": 0.0})  # A = -K_r e_r - K_v e_v - m g e3 + m a_d, and every reference is zero
    assert str(caught.value).startswith(
        f"controller: exit_initialization_mode at t = 0.000 s returned fatal: {NO_ATTITUDE}"
    )


def test_free_fall_has_no_desired_attitude(controller):
    with open_slave(controller, "controller") as slave:
        bind(slave)
        slave.initialize({})
        assert slave.step([0.0], 0.0, 0.01)[0] == pytest.approx(1.25 * 9.81)  # hover: F = m g
        with pytest.raises(SlaveError) as caught:
            slave.step([9.81], 0.01, 0.01)
    assert str(caught.value).startswith(f"controller: do_step at t = 0.010 s returned discard: {NO_ATTITUDE}")


def test_a_parameter_that_is_not_finite_is_named(controller, tmp_path):
    """By the FMU itself: a Slave would refuse the value before."""
    description = read_description(controller)
    m = next(v for v in description.modelVariables if v.name == "m")
    folder = str(tmp_path / "unpacked")
    unpack(controller, folder)
    process = FmuProcess(fmu_to_load(description, folder, "controller"), timeout_s=20.0)
    process.bind([], [ScalarVariable("m", "Real", m.valueReference)], [])
    process.call("initialize", 0.0, [], 0.0, None)
    process.begin_step(0.0, 0.01, [], [math.nan])
    reason = "returned discard: ValueError: QuadrotorController: m must be finite, got nan"
    with pytest.raises(SlaveError, match=f"^controller: do_step at t = 0.000 s {reason}"):
        process.end_step(0.0)
    process.close(0.0, is_polite=False)
