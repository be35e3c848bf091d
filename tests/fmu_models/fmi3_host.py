"""A minimal FMI 3.0 host on ctypes: `python -I -S fmi3_host.py TASK '{"argument": ...}'` prints JSON.

It needs only the standard library, so an FMU that runs here has brought everything else along, and NumPy is not missed.
"""

import ctypes as c
import json
import os
import sys
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

LOGGER = c.CFUNCTYPE(None, c.c_void_p, c.c_int, c.c_char_p, c.c_char_p)


class Instance:
    """One co-simulation instance, initialised; every call returns its FMI status, and `set` and `get` go by name."""

    def __init__(self, fmu: str, directory: str, start: dict) -> None:
        self.messages: list[tuple[int, str]] = []
        if not Path(directory).exists():
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(directory)
        root = ElementTree.parse(Path(directory) / "modelDescription.xml").getroot()
        variables = list(root.find("ModelVariables"))
        self.kinds = {v.get("name"): v.tag for v in variables}
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}
        self.sizes = {v.get("name"): product(int(d.get("start")) for d in v.iter("Dimension")) for v in variables}
        self.outputs = [v.get("name") for v in variables if v.get("causality") == "output"]
        identifier = root.find("CoSimulation").get("modelIdentifier")
        self._dll = c.CDLL(str(Path(directory) / "binaries" / "x86_64-linux" / f"{identifier}.so"))
        self._logger = LOGGER(lambda e, status, k, text: self.messages.append((status, text.decode())))
        self._dll.fmi3InstantiateCoSimulation.restype = c.c_void_p
        token, resources = root.get("instantiationToken").encode(), f"{Path(directory) / 'resources'}/".encode()
        self._instance = c.c_void_p(
            self._dll.fmi3InstantiateCoSimulation(
                b"one", token, resources, False, True, False, False, None, c.c_size_t(0), None, self._logger, None
            )
        )
        assert self._instance.value, self.messages
        zero = c.c_double(0.0)
        self.call("EnterInitializationMode", False, zero, zero, False, zero)
        assert self.set(start) == 0, self.messages
        self.call("ExitInitializationMode")

    def call(self, function: str, *arguments) -> int:
        return getattr(self._dll, f"fmi3{function}")(self._instance, *arguments)

    def set(self, values: dict) -> int:
        status = 0
        for name, value in values.items():
            flat = flattened(value)
            cells = ((c.c_bool if self.kinds[name] == "Boolean" else c.c_double) * len(flat))(*flat)
            reference = c.byref(c.c_uint(self.references[name]))
            status |= self.call(f"Set{self.kinds[name]}", reference, c.c_size_t(1), cells, c.c_size_t(len(flat)))
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

    def serialized_state(self) -> bytes:
        state, size = c.c_void_p(), c.c_size_t()
        assert self.call("GetFMUState", c.byref(state)) == 0
        assert self.call("SerializedFMUStateSize", state, c.byref(size)) == 0
        buffer = c.create_string_buffer(size.value)
        assert self.call("SerializeFMUState", state, buffer, size) == 0
        assert self.call("FreeFMUState", c.byref(state)) == 0
        return buffer.raw

    def restore(self, serialized: bytes) -> int:
        state = c.c_void_p()
        assert self.call("DeserializeFMUState", serialized, c.c_size_t(len(serialized)), c.byref(state)) == 0
        return self.call("SetFMUState", state) or self.call("FreeFMUState", c.byref(state))


def product(numbers) -> int:
    result = 1
    for number in numbers:
        result *= number
    return result


def flattened(value) -> list:
    return [x for part in value for x in flattened(part)] if isinstance(value, list) else [value]


def run(instance: Instance, first: int, last: int, script: dict | None = None) -> list:
    """Rows of all outputs after the macro steps of 10 ms first .. last - 1; `script`: values to set before each."""
    rows = []
    for k in range(first, last):
        assert instance.set((script or {}).get(str(k), {})) == 0, instance.messages
        assert instance.step(k * 0.01, 0.01) == 0, instance.messages
        rows.append(instance.get(instance.outputs))
    return rows


def simulate(new, fmu: str, n_steps: int, start: dict, script: dict) -> dict:
    instance = new(fmu, start=start)
    return {"rows": [instance.get(instance.outputs), *run(instance, 0, n_steps, script)]}


def rollback(new, fmu: str, script: dict, junk: dict) -> dict:
    """The same steps: as they come, after a rollback, and in another instance that is given the bytes."""
    instance, other = new(fmu), new(fmu)
    run(instance, 0, 20, script)
    serialized = instance.serialized_state()
    rows = [run(instance, 20, 50, script)]
    assert instance.set(junk) == 0
    run(instance, 50, 60)
    statuses = [instance.restore(serialized), other.restore(serialized)]
    rows += [run(one, 20, 50, script) for one in (instance, other)]
    return {"statuses": statuses, "rows": rows}


def fault(new, fmu: str, values: dict, n_times: int) -> dict:
    """Statuses and messages of a set and a step, in fresh instances in turn; each is freed afterwards."""
    import gc

    statuses, messages = [], []
    for _ in range(n_times):
        instance = new(fmu)
        statuses.append([instance.set(values), instance.step(0.0, 0.01)])
        messages.append(instance.messages)
        instance.call("FreeInstance")
        gc.collect()
    return {"statuses": statuses, "messages": messages}


def modules(new, fmu: str) -> dict:
    """Where each module came from that is not built in."""
    new(fmu)
    paths = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
    return {name: path for name, path in paths.items() if path}


def main() -> None:
    task, arguments = globals()[sys.argv[1]], json.loads(sys.argv[2])
    with tempfile.TemporaryDirectory() as directory:
        extracted: dict[str, str] = {}

        def new(fmu: str, start: dict | None = None) -> Instance:
            where = extracted.setdefault(fmu, str(Path(directory) / str(len(extracted))))
            return Instance(fmu, where, start or {})

        print(json.dumps(task(new, **arguments)), flush=True)
    os._exit(0)


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    main()
