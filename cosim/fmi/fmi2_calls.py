"""The calls that both interfaces of FMI 2.0 make through FMPy: loading an FMU, and functions with a checked status."""

import os
from collections.abc import Callable
from ctypes import byref, c_size_t
from typing import Any, TypeVar

from fmpy import fmi1, fmi2

from ..errors import SlaveError
from .binding import LARGEST_STATE, FmuToLoad, failure
from .fmu_log import MessageLog

_Fmu = TypeVar("_Fmu", fmi2.FMU2Slave, fmi2.FMU2Model)


def loaded(kind: type[_Fmu], to_load: FmuToLoad, log: MessageLog) -> _Fmu:
    """Load an FMU's library and instantiate it. Raises SlaveError; the log is closed then."""
    directory = os.getcwd()
    try:
        fmu = kind(
            guid=to_load.guid,
            modelIdentifier=to_load.model_identifier,
            unzipDirectory=to_load.folder,
            instanceName=to_load.instance_name,
        )
        fmu.instantiate(callbacks=log.callbacks, loggingOn=True)
    except Exception as error:  # FMPy raises nothing more special
        log.close()
        reason = f"failed: {log.reason() or error}"
        raise SlaveError(to_load.instance_name, "instantiate", None, reason) from error
    finally:
        os.chdir(directory)  # FMPy stays in the FMU's folder when loading fails
    return fmu


def checked(
    instance: str, name: str, t: float | None, log: MessageLog, function: Callable[..., Any], *arguments: object
) -> Any:
    """Return what a method of FMPy's returns. Raises SlaveError unless the FMU returns OK or Warning."""
    log.clear()
    try:
        result = function(*arguments)
        status = result if isinstance(result, int) and result < 0 else None  # none, and FMPy lets it pass
    except fmi1.FMICallException as error:
        raise SlaveError(instance, name, t, failure(error.status, log.reason())) from error
    if status is not None:
        raise SlaveError(instance, name, t, failure(status, log.reason()))
    return result


def saved_state(fmu: fmi2.FMU2Slave | fmi2.FMU2Model, call: Callable[..., Any]) -> bytes | int:
    """Return an FMU's state, serialised; only its size where that is above LARGEST_STATE. call: see checked."""
    state, size = call("get_state", fmu.getFMUstate), c_size_t()
    call("serialise_state", fmu.fmi2SerializedFMUstateSize, fmu.component, state, byref(size))
    saved: bytes | int = size.value
    if size.value <= LARGEST_STATE:
        saved = call("serialise_state", fmu.serializeFMUstate, state)
    call("free_state", fmu.freeFMUstate, state)
    return saved


def restore_state(fmu: fmi2.FMU2Slave | fmi2.FMU2Model, call: Callable[..., Any], serialised: bytes) -> None:
    """Bring an FMU back to a state that saved_state returned."""
    state = call("deserialise_state", fmu.deSerializeFMUstate, serialised)
    call("set_state", fmu.setFMUstate, state)
    call("free_state", fmu.freeFMUstate, state)
