"""A well-behaved FMU through its names: values, types, rules, states, both isolations; and files that are no FMUs."""

import ctypes
import functools
import gc
import math
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from pythonfmu import FmuBuilder

import cosim.slaves.slave
from cosim.errors import ModelDescriptionError, SlaveError, WiringError
from cosim.fmi.archive import read_description
from cosim.fmi.fmu_log import MessageLog
from cosim.fmi.folder import folders_kept
from cosim.fmi.trial_batch import BatchTrial, TrialBatch, TrialLeg
from cosim.fmi.value_buffers import ScalarVariable, buffers_of
from cosim.slaves.process import FmuProcess
from cosim.slaves.slave import open_slave

pytestmark = pytest.mark.fmu

MIXER = '''
from pythonfmu import *

class Mixer(Fmi2Slave):
    """y integrates gain u; the other variables are there for their types."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = self.y = self.offset = 0.0
        self.gain, self.count, self.steps, self.is_on, self.label, self.n = 1.0, 3, 0, True, "abc", 5
        cause, vary = Fmi2Causality, Fmi2Variability
        tunable = dict(causality=cause.parameter, variability=vary.tunable)
        fixed = dict(causality=cause.parameter, variability=vary.fixed)
        entering = dict(causality=cause.input, variability=vary.discrete)
        leaving = dict(causality=cause.output, variability=vary.discrete)
        for variable in (
            Real("u", causality=cause.input, start=0.0),
            Real("gain", **tunable),
            Real("offset", **fixed),
            Integer("n", start=5, **entering),
            Boolean("is_on", start=True, **entering),
            Integer("count", **fixed),
            String("label", **fixed),
            Integer("steps", **leaving),
            Real("y", causality=cause.output, initial=Fmi2Initial.exact, start=0.0),
            Boolean("was_on", getter=lambda: self.is_on, **leaving),
            Real("z", causality=cause.output, getter=lambda: self.y + self.offset + self.n + self.count),
            Integer("n_label", getter=lambda: len(self.label), **leaving),
        ):
            self.register_variable(variable)

    def do_step(self, t, h):
        self.y += h * self.gain * self.u
        self.steps += 1
        return True
'''


def with_description(fmu: Path, dest: Path, edit: Callable[[str], str]) -> Path:
    """A copy of an FMU with another modelDescription.xml."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(dest, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, edit(content.decode()).encode() if name == "modelDescription.xml" else content)
    return dest


def with_limits(description: str) -> str:
    """PythonFMU writes neither unit, min nor max."""
    root = ElementTree.fromstring(description)
    limits = {"u": {"min": "-10", "max": "10", "unit": "N"}, "gain": {"min": "0.1"}}
    for name, attributes in limits.items():
        root.find(f".//ScalarVariable[@name='{name}']/Real").attrib.update(attributes)
    units = ElementTree.Element("UnitDefinitions")
    ElementTree.SubElement(units, "Unit", name="N")
    root.insert(1, units)
    return ElementTree.tostring(root, encoding="unicode")


@pytest.fixture(scope="module")
def mixer(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mixer")
    script = folder / "slave_test_mixer.py"
    script.write_text(MIXER)
    built = FmuBuilder.build_FMU(script, dest=folder, canGetAndSetFMUstate=True, canSerializeFMUstate=True)
    (folder / "limited").mkdir()
    return with_description(built, folder / "limited" / "Mixer.fmu", with_limits)


@pytest.fixture(params=["process", "none", "process on a pipe"])
def isolation(request, monkeypatch) -> str:
    """Every way an instance can be reached."""
    if request.param == "process on a pipe":
        monkeypatch.setattr(cosim.slaves.slave, "FmuProcess", functools.partial(FmuProcess, kind="pipe"))
    return "none" if request.param == "none" else "process"


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch) -> Iterator[Path]:
    """Where unpacked FMUs go; nothing of them may be left after a test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def test_a_step_sets_inputs_and_tunables_and_returns_the_outputs(mixer, isolation):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], tunables=["gain"], outputs=["y"])
        slave.initialize({"y": 1.0, "gain": 2.0}, start_time=0.0, stop_time=1.0)
        assert slave.get() == (1.0,)
        assert slave.step([3.0], t=0.0, h=0.5) == (4.0,)  # 1 + 0.5 * 2 * 3
        assert slave.step([3.0], t=0.5, h=0.5, tunables=[4.0]) == (10.0,)
        assert slave.step([-1.0], t=1.0, h=0.5) == (8.0,)  # the tunable stays
        assert slave.get() == (8.0,)


def test_many_steps_are_as_many_single_ones(mixer, isolation):
    times, inputs = [0.0, 0.5, 0.75, 1.0], [[1.0], [2.0], [3.0]]
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], outputs=["y", "steps", "was_on"])
        slave.initialize({"y": 0.0})
        assert slave.many_steps(times, inputs) == [(0.5, 1.0, 1.0), (1.0, 2.0, 1.0), (1.75, 3.0, 1.0)]
        assert slave.get() == (1.75, 3.0, 1.0)
        assert slave.step([4.0], t=1.0, h=0.25) == (2.75, 4.0, 1.0)
        assert slave.many_steps([1.25], []) == []


def test_many_steps_keep_to_the_rules_of_one(mixer):
    with open_slave(mixer, "plant") as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        with pytest.raises(
            SlaveError, match=r"plant: set at t = 0\.500 s: input 'u' must be within \[-10, 10\] N, got 11"
        ):
            slave.many_steps([0.0, 0.5, 1.0], [[1.0], [11.0]])
        assert slave.many_steps([0.0, 0.5], [[1.0]]) == [(0.5,)]  # nothing had happened


LEGS = [TrialLeg([0.0, 0.5], [[1.0]]), TrialLeg([0.5, 0.75, 1.0], [[2.0], [3.0]])]


def trials(gains, **more):
    each = [BatchTrial((), [(0, None), (1, [gain])]) for gain in gains]
    return TrialBatch(0.0, 10.0, more.get("state"), more.get("is_new", True), LEGS, each)


def test_trials_begin_in_start_values_of_their_own_or_all_in_one_state(mixer, isolation):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], tunables=["gain"], outputs=["y", "steps"])
        found = slave.trials(trials([2.0, 4.0]), [{"y": 0.0}, {"y": 1.0, "gain": 3.0}])
        # y + 0.5 gain 1, with the first gain; then + 0.25 gain 2 and + 0.25 gain 3, with the second.
        assert found == ([[(1.5, 2.0), (3.0, 3.0)], [(4.5, 2.0), (7.5, 3.0)]], None)
        assert slave.get() == (7.5, 3.0)
        state = slave.get_state()
        found = slave.trials(trials([1.0, 2.0], state=state, is_new=False), [{}, {}])
        assert found == ([[(10.0, 5.0), (10.75, 6.0)], [(10.5, 5.0), (12.0, 6.0)]], None)


def test_trials_end_with_the_first_that_fails_and_tell_of_those_before_it(mixer):
    with open_slave(mixer, "plant") as slave:
        slave.bind(inputs=["u"], tunables=["gain"], outputs=["y"])
        rows, fault = slave.trials(trials([2.0, 1e308, 3.0]), [{}, {"y": 1e308}, {}])
        assert rows == [[(1.5,), (3.0,)]]
        assert re.match(r"plant: get at t = \S+ s: output 'y' is inf", str(fault))
        with pytest.raises(RuntimeError, match="must not be called after"):
            slave.get()
    with open_slave(mixer, "plant") as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        with pytest.raises(SlaveError, match="input 'u' must be within"):
            slave.trials(
                TrialBatch(0.0, 10.0, None, True, [TrialLeg([0.0, 1.0], [[11.0]])], [BatchTrial((), [(0, None)])]), [{}]
            )


def test_a_restart_makes_the_fmu_new_and_keeps_what_is_bound(mixer, isolation):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], tunables=["gain"], outputs=["y", "steps"])
        for _ in range(3):
            slave.initialize({"y": 1.0})
            assert slave.step([2.0], t=0.0, h=0.5) == (2.0, 1.0)
            slave.step([2.0], t=0.5, h=0.5, tunables=[7.0])  # the next one has a gain of 1 again
            slave.restart()


def test_values_cross_bit_for_bit(mixer, isolation):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        zero = slave.get_state()
        for u in (0.1, 1 / 3, -math.pi, 5e-324, 2.2250738585072014e-308):
            slave.set_state(zero)
            assert slave.step([u], t=0.0, h=1.0) == (u,)  # 0 + 1 * 1 * u


def test_all_types_cross_in_bound_order(mixer, isolation):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["is_on", "u", "n"], outputs=["steps", "y", "was_on", "z", "n_label"])
        slave.initialize({"count": 7, "label": "Grüße", "is_on": False, "offset": 100, "n": 2})
        assert slave.get() == (0, 0, 0, 109, 5)
        assert slave.step([1, 2.0, 40], t=0.0, h=0.5) == (1, 1, 1, 148, 5)


def test_several_slaves_step_at_the_same_time(mixer):
    slaves = [open_slave(mixer, f"plant{i}") for i in range(3)]
    for slave in slaves:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
    for k in range(5):
        for i, slave in enumerate(slaves):
            slave.begin_step([float(i)], t=float(k), h=1.0)
        assert [slave.end_step() for slave in slaves] == [(i * (k + 1.0),) for i in range(3)]
    for slave in slaves:
        slave.close()


def test_a_state_goes_back_and_into_another_instance(mixer, isolation):
    with open_slave(mixer, "a", isolation=isolation) as a, open_slave(mixer, "b", isolation=isolation) as b:
        for slave in (a, b):
            slave.bind(inputs=["u"], outputs=["y", "n_label"])
            slave.initialize({"label": "long" * 250_000} if slave is a else {})  # the state is a megabyte
        a.step([1.0], 0.0, 1.0)
        state = a.get_state()
        assert len(state) > 1_000_000
        a.step([5.0], 1.0, 1.0)
        for slave in (a, b):
            slave.set_state(state)
            assert slave.get() == (1.0, 1_000_000)
        assert a.step([5.0], 1.0, 1.0) == b.step([5.0], 1.0, 1.0) == (6.0, 1_000_000)


def test_a_state_is_not_asked_of_an_fmu_that_cannot_save_it(mixer, tmp_path):
    edit = lambda text: text.replace('canSerializeFMUstate="true"', 'canSerializeFMUstate="false"')  # noqa: E731
    with open_slave(with_description(mixer, tmp_path / "Mixer.fmu", edit), "plant") as slave:
        slave.bind(outputs=["y"])
        slave.initialize({})
        with pytest.raises(SlaveError, match=r"^plant: get_state at t = 0.000 s: Mixer.fmu cannot save and restore"):
            slave.get_state()
        assert slave.get() == (0.0,)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"inputs": ["gane"]}, "no variable 'gane' in Mixer.fmu; did you mean 'gain' (a tunable parameter)?"),
        ({"outputs": ["xyzzy"]}, "no variable 'xyzzy' in Mixer.fmu"),
        ({"inputs": ["gain"]}, "'gain' of Mixer.fmu is a tunable parameter, not an input."),
        ({"inputs": ["y"]}, "'y' of Mixer.fmu is an output, not an input."),
        ({"tunables": ["offset"]}, "'offset' of Mixer.fmu is a fixed parameter, not a tunable parameter."),
        ({"tunables": ["u"]}, "'u' of Mixer.fmu is an input, not a tunable parameter."),
        ({"outputs": ["label"]}, "'label' of Mixer.fmu is a String and cannot be exchanged."),
        ({"inputs": ["u", "u"]}, "plant: a variable is bound twice in u, u"),
    ],
    ids=["misspelt", "unknown", "tunable as input", "output as input", "fixed", "input as tunable", "String", "twice"],
)
def test_wiring_rules_are_kept(mixer, names, message):
    with open_slave(mixer, "plant") as slave, pytest.raises(WiringError) as caught:
        slave.bind(**names)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("start", "error", "message"),
    [
        ({"you": 1.0}, WiringError, "no variable 'you' in Mixer.fmu"),
        ({"z": 1.0}, WiringError, "'z' of Mixer.fmu takes no start value: it is an output, initial calculated."),
        ({"u": "1"}, WiringError, "'u' of Mixer.fmu is a Real and cannot start as '1'."),
        ({"u": True}, WiringError, "'u' of Mixer.fmu is a Real and cannot start as True."),
        ({"label": 1.0}, WiringError, "'label' of Mixer.fmu is a String and cannot start as 1.0."),
        (
            {"count": 1.5},
            SlaveError,
            "plant: set at t = 2.000 s: fixed parameter 'count' must be a whole number, got 1.5",
        ),
        ({"u": 11}, SlaveError, "plant: set at t = 2.000 s: input 'u' must be within [-10, 10] N, got 11"),
        (
            {"gain": 0.0},
            SlaveError,
            "plant: set at t = 2.000 s: tunable parameter 'gain' must be within [0.1, inf]",
        ),
        ({"y": math.inf}, SlaveError, "plant: set at t = 2.000 s: output 'y' is inf"),
    ],
    ids=["unknown", "calculated", "text", "bool", "number", "fraction", "max", "min", "inf"],
)
def test_start_values_are_checked_before_the_fmu_sees_them(mixer, start, error, message):
    with open_slave(mixer, "plant") as slave:
        slave.bind(outputs=["y"])
        with pytest.raises(error) as caught:
            slave.initialize(start, start_time=2.0)
        assert str(caught.value).startswith(message)
        slave.initialize({}, start_time=2.0)  # the slave is as it was


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("inputs", "tunables", "message"),
    [
        ([math.nan, 5], None, "plant: set at t = 0.500 s: input 'u' is nan"),
        ([-10.5, 5], None, "plant: set at t = 0.500 s: input 'u' must be within [-10, 10] N, got -10.5"),
        ([1.0, 2.5], None, "plant: set at t = 0.500 s: input 'n' must be a whole number, got 2.5"),
        (
            [1.0, 2**31],
            None,
            "plant: set at t = 0.500 s: input 'n' must be within [-2147483647, 2147483647]",
        ),
        ([1.0, 5], [-1.0], "plant: set at t = 0.500 s: parameter 'gain' must be within [0.1, inf], got -1"),
    ],
    ids=["nan", "min", "fraction", "too large for an Integer", "tunable"],
)
def test_values_are_checked_before_the_fmu_sees_them(mixer, isolation, inputs, tunables, message):
    with open_slave(mixer, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u", "n"], tunables=["gain"], outputs=["y"])
        slave.initialize({})
        slave.step([1.0, 5], t=0.0, h=0.5)
        with pytest.raises(SlaveError) as caught:
            slave.step(inputs, t=0.5, h=0.5, tunables=tunables)
        assert str(caught.value).startswith(message)
        assert slave.step([1.0, 5], t=0.5, h=0.5) == (1.0,)  # the slave is as it was


def test_an_output_outside_its_declared_range_is_a_fault(mixer, tmp_path):
    edit = functools.partial(re.sub, r'(name="y".*?<Real) ', r'\1 max="2" ', flags=re.DOTALL)
    with open_slave(with_description(mixer, tmp_path / "Mixer.fmu", edit), "plant") as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        with pytest.raises(SlaveError, match=r"get at t = 1.000 s: output 'y' must be within \[-inf, 2\], got 3"):
            slave.step([3.0], t=0.0, h=1.0)


def test_slips_of_the_calling_code_are_named(mixer):
    with pytest.raises(ValueError, match="timeout must be positive"):
        open_slave(mixer, "plant", timeout=0.0)
    with pytest.raises(ValueError, match="isolation must be"):
        open_slave(mixer, "plant", isolation="thread")
    with open_slave(mixer, "plant") as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        with pytest.raises(ValueError, match="1 values must be set, got 2"):
            slave.step([1.0, 2.0], t=0.0, h=1.0)
        with pytest.raises(RuntimeError, match="end_step must follow begin_step"):
            slave.end_step()
        slave.begin_step([1.0], t=0.0, h=1.0)
        with pytest.raises(RuntimeError, match="begin_step must be followed by end_step"):
            slave.begin_step([1.0], t=0.0, h=1.0)
        with pytest.raises(RuntimeError, match="begin_step must be followed by end_step"):
            slave.get()
        assert slave.end_step() == (1.0,)
    slave.close()
    with pytest.raises(RuntimeError, match="plant must not be called after close"):
        slave.bind(inputs=["u"])


ECHO = """
from pythonfmu import *
import shared_rule

class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, t, h):
        self.y = shared_rule.VALUE
        return True
"""


def test_fmus_that_ship_different_modules_of_one_name_run_their_own(tmp_path):
    fmus = {}
    for name, value in {"First": 1.0, "Second": 2.0}.items():
        folder = tmp_path / name
        folder.mkdir()
        script, module = folder / f"slave_test_{name}.py", folder / "shared_rule.py"
        script.write_text(ECHO.format(name=name))
        module.write_text(f"VALUE = {value}")
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", folder, module]
        subprocess.run(command, check=True, capture_output=True)  # building imports the module too
        fmus[name] = folder / f"{name}.fmu"
    with open_slave(fmus["First"], "first") as first, open_slave(fmus["Second"], "second") as second:
        for slave in (first, second):
            slave.bind(outputs=["y"])
            slave.initialize({})
        assert (first.step([], 0.0, 1.0), second.step([], 0.0, 1.0)) == ((1.0,), (2.0,))


def test_an_fmus_process_does_not_import_what_fmus_ship():
    program = "import sys, cosim.slaves.child; print({'fmu_models', 'pythonfmu', 'estimator', 'GPy'} & {*sys.modules})"
    result = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert result.stdout == "set()\n"


def test_where_folders_are_kept_the_next_instance_has_that_of_the_last_unless_it_has_changed(
    mixer, temporary, monkeypatch
):
    def folders():
        return {path.name for path in temporary.iterdir()}

    with folders_kept():
        with open_slave(mixer, "plant"), open_slave(mixer, "other"):
            first = folders()
        assert len(first) == 2
        assert folders() == first
        with open_slave(mixer, "plant") as slave:
            assert folders() == first
            slave.bind(outputs=["y"])
            slave.initialize({"y": 3.0}, start_time=0.0, stop_time=1.0)
            assert slave.get() == (3.0,)
        assert folders() == first
        assert list(temporary.rglob("*.pyc")), "what Python has compiled was not kept"
        for folder in temporary.iterdir():
            next(folder.glob("resources/*.py")).touch()
        with open_slave(mixer, "plant"):
            assert len(folders()) == 1
            assert not folders() & first
        changed = folders()
        with open_slave(mixer, "plant", isolation="none") as slave:
            slave.bind(outputs=["y"])
            assert folders() == changed
        monkeypatch.setattr("cosim.fmi.folder.MOST_KEPT", 2)
        with open_slave(mixer, "a"), open_slave(mixer, "b"), open_slave(mixer, "c"):
            assert len(folders()) == 3
        assert len(folders()) == 2
    gc.collect()
    assert folders() == set()
    with open_slave(mixer, "plant") as slave:
        slave.bind(outputs=["y"])
        assert not list(temporary.rglob("*.pyc")), "the FMU's folder has not stayed as it was"


def test_a_forgotten_slave_leaves_nothing(mixer, temporary, children):
    before = children()
    slave = open_slave(mixer, "plant")
    slave.bind(outputs=["y"])
    assert len(list(temporary.iterdir())) == len(children() - before) == 1
    del slave
    gc.collect()
    assert list(temporary.iterdir()) == []
    assert children() <= before


def test_what_a_get_does_not_fill_is_nan():
    # An FMU whose fmi2GetReal returns OK and does nothing must not be read as 0.0.
    variables = [ScalarVariable("a", "Real", 0), ScalarVariable("n", "Integer", 1), ScalarVariable("b", "Real", 2)]
    reals, integers = buffers_of(variables)
    assert (reals.positions, integers.positions) == ((0, 2), (1,))
    for buffer in (reals, integers):
        buffer.fill([1.5, 2.0, 3.0])
    assert (reals.read(), integers.read()) == ((1.5, 3.0), (2.0,))
    for buffer in (reals, integers):
        buffer.clear()
        assert all(math.isnan(value) for value in buffer.read())


def call_logger(log: MessageLog, environment: int | None, text: bytes, *arguments: object) -> None:
    """What the C code of an FMU does: a variadic call of the logger in its callbacks."""
    kinds = [ctypes.c_int if isinstance(argument, int) else ctypes.c_char_p for argument in arguments]
    fixed = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
    address = ctypes.cast(log.callbacks.logger, ctypes.c_void_p).value
    ctypes.CFUNCTYPE(None, *fixed, *kinds)(address)(environment, b"name", 3, b"logAll", text, *arguments)


def test_log_messages_reach_their_own_instance_and_are_formatted(capsys):
    logs = [MessageLog(has_plain_text=False) for _ in range(2)]
    for i, log in enumerate(logs):
        call_logger(log, log.callbacks.componentEnvironment, b"step %d of %s\nfailed", i, b"solver")
    assert [log.reason() for log in logs] == ["step 0 of solver failed", "step 1 of solver failed"]
    call_logger(logs[0], None, b"of an FMU that %s runs through FMPy", b"somebody else")
    assert capsys.readouterr().out == "[ERROR] of an FMU that somebody else runs through FMPy\n"
    for log in logs:
        log.close()


def test_a_plain_log_text_is_not_taken_for_a_format():
    log = MessageLog(has_plain_text=True)
    call_logger(log, log.callbacks.componentEnvironment, b"%s %n 100 %%")
    assert log.reason() == "%s %n 100 %"
    log.close()


TRACEBACK = b"Traceback (most recent call last):\n  File ...\n    f()\nValueError: x\nand y\n"
PLACED = (
    b'Traceback (most recent call last):\n  File "/tmp/x/resources/slave.py", line 30, in call\n    return f()\n'
    b'  File "C:\\\\x\\\\resources\\\\plant.py", line 9, in helper\n    {}["a"]\nKeyError: \'a\'\n'
)
REFUSED = PLACED.replace(b"C:\\\\x\\\\resources\\\\plant.py", b"/x/fmu_models/kernel/slave.py").replace(
    b"resources/", b"kernel/"
)
UNKNOWN = b"Fatal py exception encountered: [doStep] PyObject_CallMethod\nunknown error"


@pytest.mark.parametrize(
    ("messages", "reason"),
    [
        ([], ""),
        ([(0, b"ok"), (3, b"bad"), (1, b"hm")], "bad"),
        ([(3, b"first"), (3, b"second")], "second"),
        ([(4, b"Fatal py exception encountered: [doStep] PyObject_CallMethod\nValueError('x')")], "ValueError('x')"),
        ([(3, TRACEBACK)], "ValueError: x and y"),
        ([(3, PLACED)], "KeyError: 'a' (plant.py, line 9)"),
        ([(3, REFUSED)], "KeyError: 'a'"),
        ([(3, PLACED.replace(b"/tmp/x", b"/kernel/me"))], "KeyError: 'a' (plant.py, line 9)"),
        ([(3, PLACED.replace(b"C:\\\\x", b"D:\\\\kernel-x\\\\kernel"))], "KeyError: 'a' (plant.py, line 9)"),
        ([(3, TRACEBACK), (4, UNKNOWN)], "ValueError: x and y"),
        ([(0, b"on my way"), (4, UNKNOWN)], "unknown error"),
        ([(3, b"singular matrix"), (4, b"integrator failed")], "integrator failed"),
        ([(3, b"\xff\n\x1b[2J")], "\ufffd [2J"),
    ],
    ids=[
        "none",
        "gravest",
        "newest",
        "PythonFMU",
        "traceback",
        "placed",
        "refused",
        "under a kernel",
        "beside a kernel",
        "unknown",
        "unknown alone",
        "known",
        "rubbish",
    ],
)
def test_the_reason_is_the_gravest_message_in_one_line(messages, reason):
    log = MessageLog(has_plain_text=True)
    for status, message in messages:
        log.add(status, message)
    assert log.reason() == reason
    log.clear()
    assert log.reason() == ""
    log.close()


def damaged(folder: Path, fmu: Path, how: str) -> Path:
    """A file that is no usable FMU."""
    file = folder / "bad.fmu"
    if how == "text":
        file.write_text("not a zip")
    elif how == "cut":
        file.write_bytes(fmu.read_bytes()[:5000])
    elif how == "empty zip":
        zipfile.ZipFile(file, "w").close()
    elif how == "no binary":
        with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(file, "w") as new:
            new.writestr("modelDescription.xml", old.read("modelDescription.xml"))
    elif how != "missing":
        edits = {
            "xml": lambda text: text[:500],
            "schema": lambda text: text.replace('causality="input"', 'causality="in\nput"'),
            "FMI 3": lambda text: text.replace('fmiVersion="2.0"', 'fmiVersion="3.0"'),
            "no version": lambda text: text.replace('fmiVersion="2.0"', ""),
            "identifier": lambda text: text.replace('modelIdentifier="Mixer"', 'modelIdentifier="../../x"'),
        }
        with_description(fmu, file, edits[how])
    return file


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("missing", r"bad\.fmu cannot be read: No such file or directory$"),
        ("text", r"bad\.fmu is not a usable FMU: .*zip"),
        ("cut", r"bad\.fmu is not a usable FMU: .*zip"),
        ("empty zip", r"bad\.fmu is not a usable FMU: .*modelDescription\.xml"),
        ("no binary", r"bad\.fmu has no binary for \w+, nor for any other platform"),
        ("xml", r"bad\.fmu is not a usable FMU"),
        ("schema", r"bad\.fmu is not a usable FMU: .*causality"),
        ("FMI 3", r"bad\.fmu is not a usable FMU|not FMI 2\.0 co-simulation"),
        ("no version", r"bad\.fmu is not a usable FMU"),
        ("identifier", r"bad\.fmu (is not a usable FMU|has the model identifier)"),
    ],
    ids=lambda value: value if " " not in value or (value.isascii() and "\\" not in value) else "",
)
def test_a_bad_file_is_told_in_one_line(mixer, tmp_path, how, message):
    with pytest.raises(ModelDescriptionError, match=message) as caught:
        open_slave(damaged(tmp_path, mixer, how), "plant")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["/etc/x", "../x", "resources/../../x", "a\\b", "C:/x"])
def test_an_archive_that_leads_out_of_its_folder_is_refused(mixer, tmp_path, name):
    bad = tmp_path / "bad.fmu"
    shutil.copy(mixer, bad)
    with zipfile.ZipFile(bad, "a") as archive:
        archive.writestr(name, "x")
    with pytest.raises(ModelDescriptionError, match="outside its folder"):
        open_slave(bad, "plant")


def test_the_description_is_fmpys(mixer):
    description = read_description(mixer)
    assert description.modelName == "Mixer"
    with open_slave(mixer, "plant") as slave:
        assert [v.name for v in slave.description.modelVariables] == [v.name for v in description.modelVariables]
