"""A minimal FMI 2.0 and 3.0 host on ctypes: `python -I -S fmu_host.py TASK '{"argument": ...}'` prints JSON.

It needs only the standard library, so an FMU that runs here has brought everything else along. It leaves with
os._exit, because a pythonfmu library touches freed memory in its exit handler.
"""

import ctypes as c
import json
import os
import sys
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

LOGGER2 = c.CFUNCTYPE(None, c.c_void_p, c.c_char_p, c.c_int, c.c_char_p, c.c_char_p)
LOGGER3 = c.CFUNCTYPE(None, c.c_void_p, c.c_int, c.c_char_p, c.c_char_p)


class Callbacks(c.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", LOGGER2), ("allocate", c.c_void_p), ("free", c.c_void_p),
        ("step_finished", c.c_void_p), ("environment", c.c_void_p),
    )  # fmt: skip


class Instance:
    """One co-simulation instance, initialised; every call returns its FMI status, and `set` and `get` go by name."""

    prefix, platform = "fmi2", "linux64"
    get_state, size_state, bytes_of_state = "GetFMUstate", "SerializedFMUstateSize", "SerializeFMUstate"
    free_state, read_state, set_state = "FreeFMUstate", "DeSerializeFMUstate", "SetFMUstate"

    def __init__(self, root, directory: str, start_time: float, start: dict) -> None:
        self.messages: list[tuple[int, str]] = []
        self.describe(root)
        identifier = root.find("CoSimulation").get("modelIdentifier")
        self.dll = c.CDLL(str(Path(directory) / "binaries" / self.platform / f"{identifier}.so"))
        self.instance = c.c_void_p(self.instantiate(root, Path(directory) / "resources"))
        assert self.instance.value, self.messages
        assert self.initialize(start_time, start) == 0, self.messages

    def initialize(self, start_time: float, start: dict | None = None) -> int:
        self.enter_initialization(start_time)
        return self.set(start or {}) or self.call("ExitInitializationMode")

    def describe(self, root) -> None:
        variables = list(root.iter("ScalarVariable"))
        self.types = {v.get("name"): v[0].tag for v in variables}
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}
        self.outputs = [v.get("name") for v in variables if v.get("causality") == "output"]

    def instantiate(self, root, resources: Path):
        self.callbacks = Callbacks(LOGGER2(lambda e, i, status, k, text: self.messages.append((status, text.decode()))))
        self.dll.fmi2Instantiate.restype = c.c_void_p
        guid, where = root.get("guid").encode(), resources.as_uri().encode()
        return self.dll.fmi2Instantiate(b"one", 1, guid, where, c.byref(self.callbacks), 0, 1)

    def enter_initialization(self, start_time: float) -> None:
        self.call("SetupExperiment", 0, c.c_double(0.0), c.c_double(start_time), 0, c.c_double(0.0))
        self.call("EnterInitializationMode")

    def call(self, function: str, *arguments) -> int:
        return getattr(self.dll, f"{self.prefix}{function}")(self.instance, *arguments)

    def set(self, values: dict) -> int:
        status = 0
        for name, value in values.items():
            kind = self.types[name]
            cell = c.c_int(value) if kind == "Boolean" else c.c_double(value)
            status |= self.call(f"Set{kind}", c.byref(c.c_uint(self.references[name])), c.c_size_t(1), c.byref(cell))
        return status

    def get(self, names: list[str]) -> list[float]:
        references = (c.c_uint * len(names))(*(self.references[name] for name in names))
        values = (c.c_double * len(names))(*[float("nan")] * len(names))
        assert self.call("GetReal", references, c.c_size_t(len(names)), values) == 0, self.messages
        return list(values)

    def step(self, time: float, step_size: float) -> int:
        return self.call("DoStep", c.c_double(time), c.c_double(step_size), 1)

    def serialized_state(self) -> bytes:
        state, size = c.c_void_p(), c.c_size_t()
        assert self.call(self.get_state, c.byref(state)) == 0
        assert self.call(self.size_state, state, c.byref(size)) == 0
        buffer = c.create_string_buffer(size.value)
        assert self.call(self.bytes_of_state, state, buffer, size) == 0
        assert self.call(self.free_state, c.byref(state)) == 0
        return buffer.raw

    def restore(self, serialized: bytes) -> int:
        state = c.c_void_p()
        assert self.call(self.read_state, serialized, c.c_size_t(len(serialized)), c.byref(state)) == 0
        return self.call(self.set_state, state) or self.call(self.free_state, c.byref(state))


class Instance3(Instance):
    """The same of FMI 3.0, with arrays."""

    prefix, platform = "fmi3", "x86_64-linux"
    get_state, size_state, bytes_of_state = "GetFMUState", "SerializedFMUStateSize", "SerializeFMUState"
    free_state, read_state, set_state = "FreeFMUState", "DeserializeFMUState", "SetFMUState"

    def describe(self, root) -> None:
        variables = list(root.find("ModelVariables"))
        self.types = {v.get("name"): v.tag for v in variables}
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}
        self.sizes = {v.get("name"): product(int(d.get("start")) for d in v.iter("Dimension")) for v in variables}
        self.outputs = [v.get("name") for v in variables if v.get("causality") == "output"]

    def instantiate(self, root, resources: Path):
        self.logger = LOGGER3(lambda e, status, k, text: self.messages.append((status, text.decode())))
        self.dll.fmi3InstantiateCoSimulation.restype = c.c_void_p
        token, where = root.get("instantiationToken").encode(), f"{resources}/".encode()
        return self.dll.fmi3InstantiateCoSimulation(
            b"one", token, where, False, True, False, False, None, c.c_size_t(0), None, self.logger, None
        )

    def enter_initialization(self, start_time: float) -> None:
        self.call("EnterInitializationMode", False, c.c_double(0.0), c.c_double(start_time), False, c.c_double(0.0))

    def set(self, values: dict) -> int:
        status = 0
        for name, value in values.items():
            flat = flattened(value)
            cells = ((c.c_bool if self.types[name] == "Boolean" else c.c_double) * len(flat))(*flat)
            reference = c.byref(c.c_uint(self.references[name]))
            status |= self.call(f"Set{self.types[name]}", reference, c.c_size_t(1), cells, c.c_size_t(len(flat)))
        return status

    def get(self, names: list[str]) -> list[float]:
        references = (c.c_uint * len(names))(*(self.references[name] for name in names))
        n = sum(self.sizes[name] for name in names)
        values = (c.c_double * n)(*[float("nan")] * n)
        assert self.call("GetFloat64", references, c.c_size_t(len(names)), values, c.c_size_t(n)) == 0, self.messages
        return list(values)

    def step(self, time: float, step_size: float) -> int:
        flags, end = (c.c_bool * 3)(), c.c_double()
        at = [c.byref(flags, i) for i in range(3)]
        return self.call("DoStep", c.c_double(time), c.c_double(step_size), True, *at, c.byref(end))


def instance_of(fmu: str, directory: str, start_time: float = 0.0, start: dict | None = None) -> Instance:
    """An instance of the FMU, unpacked into directory once: writing over a library that is in use is fatal."""
    if not Path(directory).exists():
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(directory)
    root = ElementTree.parse(Path(directory) / "modelDescription.xml").getroot()
    kind = Instance3 if root.get("fmiVersion").startswith("3") else Instance
    return kind(root, directory, start_time, start or {})


def product(numbers) -> int:
    result = 1
    for number in numbers:
        result *= number
    return result


def flattened(value) -> list:
    return [x for part in value for x in flattened(part)] if isinstance(value, list) else [value]


def run(instance: Instance, first: int, last: int, start_time: float = 0.0, script: dict | None = None) -> list:
    """Rows of all outputs after the steps first .. last - 1 of 10 ms; `script` has the values to set before each."""
    rows = []
    for k in range(first, last):
        assert instance.set((script or {}).get(str(k), {})) == 0, instance.messages
        assert instance.step(start_time + k * 0.01, 0.01) == 0, instance.messages
        rows.append(instance.get(instance.outputs))
    return rows


def simulate(new, fmu: str, n_steps: int, start: dict, script: dict | None = None, start_time: float = 0.0) -> dict:
    instance = new(fmu, start=start, start_time=start_time)
    initial = instance.get(instance.outputs)
    return {"names": instance.outputs, "rows": [initial, *run(instance, 0, n_steps, start_time, script)]}


def rollback(new, fmu: str, script: dict, junk: dict) -> dict:
    """The same steps: as they come, after a rollback, and in another instance that is given the bytes."""
    instance, other = new(fmu), new(fmu)
    run(instance, 0, 20, script=script)
    serialized = instance.serialized_state()
    at_once = instance.get(instance.outputs)
    rows = [run(instance, 20, 50, script=script)]
    assert instance.set(junk) == 0
    run(instance, 50, 60)
    statuses = [instance.restore(serialized), other.restore(serialized)]
    after = [instance.get(instance.outputs), other.get(instance.outputs)]
    rows += [run(one, 20, 50, script=script) for one in (instance, other)]
    return {"statuses": statuses, "at_once": [at_once, *after], "rows": rows}


def together(new, fmus: list[str], n_steps: int) -> dict:
    instances = [new(fmu) for fmu in fmus]
    for k in range(n_steps):
        assert [instance.step(k * 0.01, 0.01) for instance in instances] == [0] * len(instances)
    return {"rows": [instance.get(instance.outputs) for instance in instances]}


def fault(new, fmu: str, values: dict, n_times: int, start: dict | None = None) -> dict:
    """Statuses and messages of a set and a step, in fresh instances in turn; each is freed afterwards."""
    import gc

    statuses, messages = [], []
    for _ in range(n_times):
        instance = new(fmu, start=start)
        statuses.append([instance.set(values), instance.step(0.0, 0.01)])
        messages.append(instance.messages)
        instance.call("FreeInstance")
        gc.collect()
    return {"statuses": statuses, "messages": messages}


def refusals(new, fmu: str) -> dict:
    """Statuses of calls that are refused, then of reset, of going back to a state, of a step, each time; and a free."""
    instance = new(fmu)
    assert instance.step(0.0, 0.01) == 0
    serialized, expected = instance.serialized_state(), instance.get(instance.outputs)
    texts, whole = (c.c_char_p * 1)(b"text"), (c.c_longlong * 1)(1)
    is_3, real = instance.prefix == "fmi3", c.c_uint(instance.references[instance.outputs[0]])
    n, sizes = c.c_size_t(1), (c.c_size_t(1),) if instance.prefix == "fmi3" else ()
    number, integer = ("Float64", "Int32") if is_3 else ("Real", "Integer")
    calls = {f"Set{kind}": (c.byref(real), n, cells) for kind, cells in (("String", texts), (integer, whole))}
    calls |= {f"Get{kind}": (c.byref(real), n, cells) for kind, cells in (("String", texts), (integer, whole))}
    unknown = [
        (f"{verb}{number}", (c.byref(c.c_uint(r)), n, whole)) for verb in ("Get", "Set") for r in (999, 2**32 - 1)
    ]
    event_mode = [("UpdateDiscreteStates", (None,) * 6)] if is_3 else []
    statuses = {}
    for function, arguments in [*calls.items(), *unknown, *event_mode]:
        refused = instance.call(function, *arguments, *(() if len(arguments) == 6 else sizes))
        after = [instance.call("Reset"), instance.initialize(0.0), instance.step(0.0, 0.01)]
        after += [instance.restore(serialized), instance.get(instance.outputs) == expected, instance.step(0.01, 0.01)]
        statuses[f"{function} {len(statuses)}"] = [refused, after]
    instance.call("FreeInstance")
    return {"statuses": statuses, "messages": instance.messages}


def modules(new, fmu: str) -> dict:
    """Where each module came from that is not built in, relative to the FMU or to the standard library."""
    new(fmu)
    paths = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
    return {name: path for name, path in paths.items() if path}


def main() -> None:
    task, arguments = globals()[sys.argv[1]], json.loads(sys.argv[2])
    with tempfile.TemporaryDirectory() as directory:
        extracted: dict[str, str] = {}

        def new(fmu: str, **options) -> Instance:
            where = extracted.setdefault(fmu, str(Path(directory) / str(len(extracted))))
            return instance_of(fmu, where, **options)

        result = task(new, **arguments)
        print(json.dumps(result), flush=True)
    os._exit(0)


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    main()
