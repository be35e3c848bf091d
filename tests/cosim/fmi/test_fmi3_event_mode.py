"""FMI 3.0 co-simulation with event mode: tunables that change there only, and events that the FMU announces."""

import re
import shutil

import pytest

from benchmarks.native_fmus import FOREIGN, build_c
from cosim import SlaveError, open_slave

pytestmark = pytest.mark.fmu
H = 0.01  # s


@pytest.fixture
def built(tmp_path):
    """built(name, description, (old, new), ...): an FMU of FOREIGN compiled with these texts replaced in its files."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")

    def build(name, description, *replacements, options=()):
        source, text = (FOREIGN / f"{name}.c").read_text(), (FOREIGN / f"{description}.xml").read_text()
        for old, new in replacements:
            assert (source + text).count(old) == 1, old
            source, text = source.replace(old, new), text.replace(old, new)
        (tmp_path / "Changed.c").write_text(source)
        return build_c(tmp_path / "Changed.c", text, tmp_path / "Changed.fmu", *options)

    return build


def with_event_mode(built, *options):
    return built("Axis", "Axis-3", ("<CoSimulation ", '<CoSimulation hasEventMode="true" '), options=options)


def stepped(path, isolation="none"):
    """Velocity of the axis after each step: the mass is changed at the third."""
    with open_slave(path, "axis", isolation=isolation) as slave:
        slave.bind(["f"], ["mass.m"], ["mass.v"])
        slave.initialize({"mass.s": 1.0})
        return [slave.step([1.0 + k], k * H, H, [3.0] if k == 2 else None) for k in range(5)]


@pytest.mark.parametrize("isolation", ["none", "process"])
def test_a_tunable_that_changes_in_event_mode_only_is_changed(foreign, built, isolation):
    """As in an FMU of the same equations that has no event mode."""
    assert stepped(with_event_mode(built, "-DLOCKED=M"), isolation) == stepped(foreign / "Axis-3.fmu")


def test_without_event_mode_it_was_refused(built):
    with pytest.raises(SlaveError, match=re.escape("axis: set_float64 at t = 0.020 s returned error")):
        stepped(built("Axis", "Axis-3", options=["-DLOCKED=M"]))


@pytest.mark.parametrize("h", [0.01, 0.04, 0.25])
def test_no_step_passes_an_event_that_is_announced(built, h):
    """The count is that of the tenths of a second, one at a communication point included."""
    with open_slave(built("events/Stair", "events/Stair-3"), "stair", isolation="none") as slave:
        slave.bind([], [], ["count"])
        slave.initialize({})
        counts = [slave.step([], k * h, h)[0] for k in range(round(1.0 / h))]
    assert counts == [int((k + 1) * h * 10 + 1e-6) for k in range(len(counts))]


def test_a_state_has_the_next_event(built):
    with open_slave(built("events/Stair", "events/Stair-3"), "stair", isolation="none") as slave:
        slave.bind([], ["period"], ["count"])
        slave.initialize({})
        slave.step([], 0.0, 0.25)
        state = slave.get_state()
        after = [slave.step([], 0.25 + 0.1 * k, 0.1, [0.3] if k == 1 else None) for k in range(9)]
        slave.set_state(state)
        assert [slave.step([], 0.25 + 0.1 * k, 0.1, [0.3] if k == 1 else None) for k in range(9)] == after
    assert [count for (count,) in after] == [3, 4, 4, 4, 5, 5, 5, 6, 6]


def test_an_event_that_is_due_for_ever_is_told(built):
    never = built("events/Stair", "events/Stair-3", ("v[NEXT] += v[PERIOD];", ""))
    with open_slave(never, "stair", isolation="none") as slave:
        slave.bind([], [], ["count"])
        slave.initialize({})
        with pytest.raises(SlaveError, match="had more than 100 events at one time"):
            slave.step([], 0.0, 0.25)
