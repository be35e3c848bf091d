"""The program of an FMU's own process: it answers the requests of an FmuProcess by calling the FMU's binding.

Neither fmu_models nor pythonfmu is imported here: an FMU ships its own. Supervision is in supervision/.
"""

import contextlib
import sys
from collections.abc import Callable
from typing import Any, Final, NoReturn

from ..errors import COLON, SlaveError
from ..fmi.binding import Binding, FmuToLoad
from ..fmi.loading import load
from ..fmi.renewal import Renewal
from ..fmi.step_batch import take_steps
from ..fmi.trial_batch import take_trials
from .channel import CALL, FAULT, RESULT, Channel, StepCodec, decode, encode, open_channel
from .log_lines import LogSender
from .supervision.forks import UnforkedChannel
from .supervision.supervised_child import SupervisedChild

_CALLS: Final = frozenset(
    {"bind", "initialize", "enter_initialization", "propagate", "exit_initialization", "get", "get_state", "set_state"}
    | {"close", "slopes"}
)


def main(channel_argument: str) -> NoReturn:
    """Serve one FMU to the process that started this one."""
    run(channel_argument, _serve)


def run(channel_argument: str, serve: Callable[[Channel, SupervisedChild], None]) -> NoReturn:
    """Call serve with the channel to the process that started this one, report what it raises, and end."""
    process = SupervisedChild()
    sys.dont_write_bytecode = True
    channel = UnforkedChannel(open_channel(channel_argument))
    try:
        channel.send(encode(RESULT, None))
        serve(channel, process)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        process.leave(is_orphaned=True)
    except SlaveError as error:
        _report(channel, [error.function, error.time, error.reason, error.form])
    except Exception as error:  # whatever the FMU has caused, the other side must learn of it
        _report(channel, [None, None, f"{type(error).__name__}: {error}", COLON])
    process.leave()


def _serve(channel: Channel, process: SupervisedChild) -> None:
    """Load the FMU that the first message names, and answer requests until it is closed."""
    fmu = FmuToLoad(*decode(channel.receive(None))[0])
    process.end_with_parent(fmu.folder)
    sys.dont_write_bytecode = not fmu.writes_bytecode
    log = LogSender(channel)
    binding = load(fmu, log)
    channel.send(encode(RESULT, None))
    codec = StepCodec(0, 0, 0)
    bound: Any = [(), (), ()]

    def renewed() -> Binding:
        nonlocal binding
        binding.close()
        binding = load(fmu, log)
        binding.bind(*bound)
        return binding

    renewal = Renewal(renewed)
    while True:
        message = channel.receive(None)
        log.call_begins()
        if message[0] != CALL:
            channel.send(codec.encode_values(binding.step(*codec.decode_step(message))))
            continue
        (function, arguments), blob = decode(message)
        if function == "restart":
            binding.close()
            binding = load(fmu, log)
            channel.send(encode(RESULT, None))
            continue
        if function == "many_steps":
            channel.send(encode(RESULT, None, take_steps(binding.step, blob or b"")))
            continue
        if function == "trials":
            channel.send(encode(RESULT, None, take_trials(binding, renewal, blob or b"")))
            continue
        if function not in _CALLS:
            raise ValueError(f"no such call: {function!r}")
        result = getattr(binding, function)(*([blob] if blob is not None else arguments))
        if function == "bind":
            codec, bound = StepCodec(*map(len, arguments)), arguments
        channel.send(encode(RESULT, None, result) if isinstance(result, bytes) else encode(RESULT, result))
        if function == "close":
            return


def _report(channel: Channel, fault: list[object]) -> None:
    with contextlib.suppress(OSError):
        channel.send(encode(FAULT, fault))
