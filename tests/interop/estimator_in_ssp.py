"""An SSP package with an estimator in the loop, in FMPy or libcosim: `python estimator_in_ssp.py IMPORTER FILE STARTS`.

Prints what the adaptive controller held at the end.
"""

import json
import os
import sys
from types import SimpleNamespace

STOP_TIME, MACRO_STEP = 2.0, 0.01


def in_fmpy(file: str, starts: dict[str, float]) -> list[float]:
    """FMPy takes parameters as an object, not from the package."""
    from fmpy.ssp.simulation import simulate_ssp

    values = SimpleNamespace(parameters=[SimpleNamespace(name=n, value=v) for n, v in starts.items()])
    result = simulate_ssp(file, stop_time=STOP_TIME, step_size=MACRO_STEP, parameter_set=values)
    return [float(result[f"controller.{name}"][-1]) for name in ("m_held", "l_held")]


def in_libcosim(file: str, starts: dict[str, float]) -> list[float]:
    """Start values come from the package, but for states: libcosim sets no start value of an output."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    execution = CosimExecution.from_ssp_file(file, MACRO_STEP * 1e9)
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    assert execution.step(round(STOP_TIME / MACRO_STEP))
    controller = execution.slave_index_from_instance_name("controller")
    references = {v.name.decode(): v.reference for v in execution.slave_variables(controller)}
    return list(observer.last_real_values(controller, [references["m_held"], references["l_held"]]))


if __name__ == "__main__":
    run = {"fmpy": in_fmpy, "libcosim": in_libcosim}[sys.argv[1]]
    print(json.dumps(run(sys.argv[2], json.loads(sys.argv[3]))), flush=True)
    os._exit(0)  # before pythonfmu's exit handler
