"""Many steps of an FMU as one call: the bytes that go to its process, and back."""

import struct
from array import array
from collections.abc import Callable, Sequence
from typing import Final

_HEAD: Final = struct.Struct("<QQQ")
Step = Callable[[float, float, Sequence[float], Sequence[float] | None], tuple[float, ...]]
"""`Binding.step`."""


def encode_steps(
    times: Sequence[float], inputs: Sequence[Sequence[float]], tunables: Sequence[float] | None = None
) -> bytes:
    """Encode n steps, from each of times (n + 1,) [s] to the next with inputs (n, p); tunables are set before them."""
    flat = array("d", times)
    for values in inputs:
        flat.extend(values)
    flat.extend(tunables or ())
    return _HEAD.pack(len(inputs), len(inputs[0]) if inputs else 0, len(tunables or ())) + flat.tobytes()


def take_steps(step: Step, message: bytes) -> bytes:
    """Take the steps of an encode_steps message; return the outputs after each, encoded."""
    n, p, n_tunables = _HEAD.unpack_from(message)
    values = array("d", message[_HEAD.size :])
    outputs = array("d")
    tunables = values[len(values) - n_tunables :] if n_tunables else None
    for k in range(n):
        first = n + 1 + k * p
        outputs.extend(step(values[k], values[k + 1] - values[k], values[first : first + p], tunables))
        tunables = None
    return outputs.tobytes()


def decode_outputs(message: bytes, n_steps: int) -> list[tuple[float, ...]]:
    """Return the outputs after each step. Raises ValueError for any other bytes."""
    values = array("d", message).tolist()
    width, rest = divmod(len(values), max(n_steps, 1))
    if rest:
        raise ValueError(f"{n_steps} steps cannot have {len(values)} outputs.")
    return [tuple(values[k * width : (k + 1) * width]) for k in range(n_steps)]
