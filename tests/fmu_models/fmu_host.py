"""A minimal FMI 2.0 host on ctypes: `python -I -S fmu_host.py TASK '{"argument": ...}'` prints JSON.

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

LOGGER = c.CFUNCTYPE(None, c.c_void_p, c.c_char_p, c.c_int, c.c_char_p, c.c_char_p)


class Callbacks(c.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", LOGGER), ("allocate", c.c_void_p), ("free", c.c_void_p),
        ("step_finished", c.c_void_p), ("environment", c.c_void_p),
    )  # fmt: skip


class Instance:
    """One instance of an FMU; every call returns its FMI status, and `set` and `get` go by name."""

    def __init__(self, fmu: str, directory: str, start_time: float = 0.0, start: dict | None = None) -> None:
        self.messages: list[tuple[int, str]] = []
        if not Path(directory).exists():  # writing over a library that is in use is fatal
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(directory)
        root = ElementTree.parse(Path(directory) / "modelDescription.xml").getroot()
        self.types = {v.get("name"): v[0].tag for v in root.iter("ScalarVariable")}
        self.references = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
        self.outputs = [v.get("name") for v in root.iter("ScalarVariable") if v.get("causality") == "output"]
        identifier = root.find("CoSimulation").get("modelIdentifier")
        self._dll = c.CDLL(str(Path(directory) / "binaries" / "linux64" / f"{identifier}.so"))
        self._callbacks = Callbacks(LOGGER(lambda e, i, status, k, text: self.messages.append((status, text.decode()))))
        self._dll.fmi2Instantiate.restype = c.c_void_p
        resources = (Path(directory) / "resources").as_uri().encode()
        component = self._dll.fmi2Instantiate(
            identifier.encode(), 1, root.get("guid").encode(), resources, c.byref(self._callbacks), 0, 1
        )
        assert component, self.messages
        self._component = c.c_void_p(component)
        self.call("SetupExperiment", 0, c.c_double(0.0), c.c_double(start_time), 0, c.c_double(0.0))
        self.call("EnterInitializationMode")
        self.set(start or {})
        self.call("ExitInitializationMode")

    def call(self, function: str, *arguments) -> int:
        return getattr(self._dll, f"fmi2{function}")(self._component, *arguments)

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
        assert self.call("GetFMUstate", c.byref(state)) == 0
        assert self.call("SerializedFMUstateSize", state, c.byref(size)) == 0
        buffer = c.create_string_buffer(size.value)
        assert self.call("SerializeFMUstate", state, buffer, size) == 0
        assert self.call("FreeFMUstate", c.byref(state)) == 0
        return buffer.raw

    def restore(self, serialized: bytes) -> int:
        state = c.c_void_p()
        assert self.call("DeSerializeFMUstate", serialized, c.c_size_t(len(serialized)), c.byref(state)) == 0
        return self.call("SetFMUstate", state) or self.call("FreeFMUstate", c.byref(state))


def run(instance: Instance, first: int, last: int, macro_step: float = 0.01, script: dict | None = None) -> list:
    """Rows of all outputs after the macro steps first .. last - 1; `script` has the values to set before each."""
    rows = []
    for k in range(first, last):
        assert instance.set((script or {}).get(str(k), {})) == 0, instance.messages
        assert instance.step(k * macro_step, macro_step) == 0, instance.messages
        rows.append(instance.get(instance.outputs))
    return rows


def simulate(new, fmu: str, n_steps: int, start: dict, script: dict | None = None, start_time: float = 0.0) -> dict:
    instance = new(fmu, start=start, start_time=start_time)
    initial = instance.get(instance.outputs)
    return {"names": instance.outputs, "rows": [initial, *run(instance, 0, n_steps, script=script)]}


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


def fault(new, fmu: str, start: dict | None, values: dict, n_times: int) -> dict:
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


def modules(new, fmu: str) -> dict:
    """Where each module came from that is not built in, relative to the FMU or to the standard library."""
    new(fmu)
    paths = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
    return {name: path for name, path in paths.items() if path}


def main() -> None:
    task, arguments = globals()[sys.argv[1]], json.loads(sys.argv[2])
    with tempfile.TemporaryDirectory() as directory:
        n_instances = iter(range(1000))
        extracted: dict[str, str] = {}

        def new(fmu: str, **options) -> Instance:
            where = extracted.setdefault(fmu, str(Path(directory) / str(next(n_instances))))
            return Instance(fmu, where, **options)

        result = task(new, **arguments)
        print(json.dumps(result), flush=True)
    os._exit(0)


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    main()
