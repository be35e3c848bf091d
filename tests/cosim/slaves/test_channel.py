"""Channels keep messages whole and say when the other side is late or gone; encodings come back as they were."""

import os
import pickle
import struct
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import COLON, IN_THE_CALL, SlaveError
from cosim.slaves.channel import (
    CALL,
    LARGEST_MESSAGE,
    PACKET_SIZE,
    Channel,
    StepCodec,
    channel_pair,
    decode,
    encode,
    open_channel,
)

doubles = st.floats(width=64)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=20,
)


def bits(values) -> bytes:
    return struct.pack(f"{len(values)}d", *values)


@pytest.fixture(params=["packet", "pipe"])
def ends(request) -> Iterator[tuple[Channel, Channel]]:
    ours, child_end = channel_pair(request.param)
    theirs = open_channel(f"{request.param}:{os.dup(child_end.handle)}")  # as after the child has inherited it
    child_end.close()
    yield ours, theirs
    ours.close()
    theirs.close()


@pytest.mark.parametrize(
    "size", [1, 8, PACKET_SIZE - 9, PACKET_SIZE - 8, PACKET_SIZE - 1, PACKET_SIZE, PACKET_SIZE + 1, 3 * PACKET_SIZE - 8]
)
def test_a_message_of_any_size_arrives_whole(ends, size):
    ours, theirs = ends
    message = os.urandom(size)
    sender = threading.Thread(target=ours.send, args=(message,))
    sender.start()
    assert theirs.receive(10.0) == message
    sender.join()


def test_megabytes_arrive_whole_and_keep_their_place(ends):
    ours, theirs = ends
    messages = [b"before", os.urandom(5_000_000), b"after"]
    sender = threading.Thread(target=lambda: [ours.send(m) for m in messages])
    sender.start()
    assert [theirs.receive(10.0) for _ in messages] == messages
    sender.join()


def test_borders_between_messages_are_kept(ends):
    ours, theirs = ends
    for message in (b"a", b"bc", b"d"):
        ours.send(message)
    assert [theirs.receive(None) for _ in range(3)] == [b"a", b"bc", b"d"]


def test_a_silent_peer_is_a_timeout_and_the_channel_goes_on(ends):
    ours, theirs = ends
    with pytest.raises(TimeoutError):
        ours.receive(0.01)
    theirs.send(b"late")
    assert ours.receive(5.0) == b"late"


def test_a_dead_peer_is_seen_without_waiting_for_the_timeout(ends):
    ours, theirs = ends
    theirs.close()
    with pytest.raises(EOFError):
        ours.receive(1e6)
    with pytest.raises(OSError):  # noqa: PT011  which one depends on the system
        ours.send(b"anybody there?")


def test_a_peer_that_dies_while_we_wait_ends_the_waiting(ends):
    ours, theirs = ends
    killer = threading.Timer(0.05, theirs.close)
    killer.start()
    with pytest.raises(EOFError):
        ours.receive(1e6)
    killer.join()


def test_an_empty_message_is_refused_since_it_means_the_end(ends):
    with pytest.raises(ValueError, match="must not be empty"):
        ends[0].send(b"")


def test_an_announced_length_beyond_reason_is_refused_before_memory_is_taken():
    ours, child_end = channel_pair("packet")
    theirs = child_end.owner
    theirs.send(struct.pack("<Q", LARGEST_MESSAGE + 1).ljust(PACKET_SIZE, b"\0"))
    with pytest.raises(OSError, match="was announced"):
        ours.receive(1.0)
    ours.close()
    child_end.close()


def test_pieces_that_drip_in_are_held_to_one_deadline():
    ours, child_end = channel_pair("packet")
    theirs = child_end.owner
    theirs.send(struct.pack("<Q", 100 * PACKET_SIZE).ljust(PACKET_SIZE, b"\0"))
    stop = threading.Event()

    def drip() -> None:
        while not stop.wait(0.02):
            theirs.send(b"x")

    dripping = threading.Thread(target=drip)
    dripping.start()
    with pytest.raises(TimeoutError):
        ours.receive(0.1)
    stop.set()
    dripping.join()
    ours.close()
    child_end.close()


@given(
    t=doubles, h=doubles, inputs=st.lists(doubles), tunables=st.none() | st.lists(doubles), outputs=st.lists(doubles)
)
def test_a_step_comes_back_bit_for_bit(t, h, inputs, tunables, outputs):
    codec = StepCodec(len(inputs), len(tunables or ()), len(outputs))
    its_t, its_h, its_inputs, its_tunables = codec.decode_step(codec.encode_step(t, h, inputs, tunables))
    assert bits([its_t, its_h, *its_inputs]) == bits([t, h, *inputs])
    assert (its_tunables is None) == (tunables is None)
    assert bits(its_tunables or ()) == bits(tunables or ())
    assert bits(codec.decode_values(codec.encode_values(outputs))) == bits(outputs)


@given(value=json_values, blob=st.none() | st.binary())
def test_a_call_comes_back_as_it_was(value, blob):
    assert decode(encode(CALL, value, blob)) == (value, blob)


@given(message=st.binary(max_size=200))
def test_bytes_that_are_no_message_are_a_value_error(message):
    try:
        decode(bytes([CALL]) + message)
    except ValueError:
        return
    pytest.fail("random bytes were taken for a message")


def test_deeply_nested_json_is_a_value_error():
    text = b"[" * 100_000
    with pytest.raises(ValueError, match="not of the form"):
        decode(struct.pack("<BI", CALL, len(text)) + text)


def test_values_of_another_length_are_refused():
    with pytest.raises(struct.error):
        StepCodec(1, 0, 2).decode_values(StepCodec(1, 0, 3).encode_values([1.0, 2.0, 3.0]))


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            SlaveError("quadrotor", "do_step", 1.25, "returned discard"),
            "quadrotor: do_step at t = 1.250 s returned discard",
        ),
        (SlaveError("plant", "get", 0.02, "output 'y' is nan", COLON), "plant: get at t = 0.020 s: output 'y' is nan"),
        (SlaveError("plant", "do_step", 0.05, "it ended", IN_THE_CALL), "plant: it ended in do_step at t = 0.050 s"),
        (SlaveError("plant", "instantiate", None, "failed"), "plant: instantiate failed"),
        (SlaveError("plant", "do_step", 0.00025, "failed"), "plant: do_step at t = 0.00025 s failed"),
        (SlaveError("plant", "do_step", 0.1, "a\nb\r\n\x1b[31mc\0"), "plant: do_step at t = 0.100 s a b [31mc"),
    ],
    ids=["phrase", "clause", "death", "no time", "fine time", "control characters"],
)
def test_a_slave_error_is_one_line_and_survives_pickling(error, message):
    assert str(error) == message
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.reason, copy.time) == (message, error.reason, error.time)


def test_a_slave_error_has_only_the_known_forms():
    with pytest.raises(ValueError, match="form must be one of"):
        SlaveError("plant", "do_step", 0.0, "failed", "{call.__class__}")
