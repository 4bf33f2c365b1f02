"""The bytes that cross the trust boundary.

A *job* runs in one forked child of the worker. The host gives the child one end of a fresh socket pair. It sends one
JSON job and receives a stream of messages; if the child offers to continue, another job may follow. Every message is
``<u8 kind><u32 length><payload>``. Lengths are bounded, kinds are known, and nothing is unpickled or evaluated. An
interactive job requests each action with ASK and sends nothing until it has received the action: JSON of at most
MAX_JSON bytes, in a message of kind ACTION.

Observations travel as raw bytes with a *layout*: a JSON description of the value (dtype, shape, keys) that is sent once
and then named by its number, so a step of a picture game is one fixed header and the frame. A long value with the same
bytes as the last long one is only marked as repeated, and so is an info. Steps that repeat both share one message.

This module imports only the standard library, which keeps the start of the command line and of the worker short.
"""

from __future__ import annotations

import struct
from enum import IntEnum

HEADER = struct.Struct("<BI")

#: Fixed part of a RESET, STEP or AFTER message: flags (bit 0 terminated, bit 1 truncated, SAME, SAME_INFO), the three
#: value types, the reward, microseconds spent in the call, layout number, observation bytes, info bytes.
STEP = struct.Struct("<BBBBdIHII")

#: Fixed part of a RENDER or REREAD message: flags (SAME), layout number. The value follows.
VALUE = struct.Struct("<BH")

#: Flag of a value without bytes: it repeats layout and bytes of the last value of at least LONG bytes.
SAME = 4
LONG = 256
#: Flag of a step without info bytes: it repeats the info of the previous step or reset.
SAME_INFO = 8

MAX_OBSERVATION = 8 * 1024 * 1024
MAX_INFO = 64 * 1024
#: Bytes of a JSON message, and of the kinds with spaces or the result of a search.
MAX_JSON = 256 * 1024
MAX_LONG_JSON = 4 * 1024 * 1024
MAX_LAYOUTS = 4096
MAX_PARTS = 100_000
MAX_DEPTH = 8
#: Items of a dictionary, list or tuple, and dimensions of an array.
MAX_ITEMS = 4096
MAX_DIMENSIONS = 32


#: Bytes of a job, which has the source, and of a control message.
MAX_MESSAGE = 16 * 1024 * 1024


class Kind(IntEnum):
    """The kinds of messages from a job."""

    PHASE = 1  #: JSON string: the call that is about to run (import, construct, reset, step, render, close, search)
    LOADED = 2  #: JSON object: what the file defines
    LAYOUT = 3  #: JSON object: the next observation layout
    RESET = 4  #: STEP struct, observation, info
    ACTION = 5  #: JSON: the action that a policy inside the worker chose
    STEP = 6  #: STEP struct, observation, info
    AFTER = 7  #: like STEP, for a step taken after the episode's end
    RENDER = 8  #: VALUE struct, frame
    REREAD = 9  #: VALUE struct, the previous observation's bytes as they are now
    ACTED = 10  #: JSON object: the action before and after step()
    FAULT = 11  #: JSON object: an exception, or a return value of the wrong form
    TICK = 12  #: empty: the job is alive
    RESULT = 13  #: JSON object: the result of a search
    #: JSON object: the job is complete; see :class:`envcraft_protocol.jobs.End`
    END = 14
    ASK = 15  #: empty: the job waits for its next action
    STEPS = 16  #: STEP structs, each with SAME and SAME_INFO


#: The kinds whose payload is a fixed part and a value's bytes.
VALUED = frozenset((Kind.RESET, Kind.STEP, Kind.AFTER, Kind.RENDER, Kind.REREAD))


def longest(kind: int) -> int:
    """The maximum length in bytes of the payload of a message of this kind."""
    if kind in VALUED:
        return STEP.size + MAX_OBSERVATION + MAX_INFO
    return MAX_LONG_JSON if kind in (Kind.LOADED, Kind.RESULT) else MAX_JSON


class Type(IntEnum):
    """The Python type of a reward or a flag in the worker."""

    BOOL = 0
    NUMPY_BOOL = 1
    INT = 2
    NUMPY_INT = 3
    FLOAT = 4
    NUMPY_FLOAT = 5
    NONE = 6
    STR = 7
    ARRAY = 8
    OTHER = 9

    @property
    def words(self) -> str:
        return {
            0: "bool", 1: "numpy.bool", 2: "int", 3: "numpy integer", 4: "float",
            5: "numpy floating", 6: "None", 7: "str", 8: "numpy.ndarray", 9: "another type",
        }[int(self)]  # fmt: skip
