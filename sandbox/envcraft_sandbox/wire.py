"""The bytes that cross the trust boundary, as both sides must read them.

A *job* runs in one forked child of the worker. The host hands the child one end of a fresh socket pair; down goes one
JSON job, up comes a stream of messages, and where that offers to go on, another job may follow. Every message is ``<u8
kind><u32 length><payload>``; lengths are bounded, kinds are known, and nothing is ever unpickled or evaluated. A job
whose actions a player chooses asks for each (ASK) and sends nothing until it has it: JSON of at most MAX_JSON bytes, in
a message of kind ACTION.

Observations travel as raw bytes beside a *layout*: a JSON description of the value (dtype, shape, keys) that is sent
once and then referred to by number, so that a step of a picture game is one fixed header and exactly the frame. A long
value whose bytes are those of the last long one is only said to be so, and so is an info; steps of which neither is new
come several in one message.

This module is the standard library only: the worker imports it inside the sandbox.
"""

from __future__ import annotations

import struct
from enum import IntEnum

HEADER = struct.Struct("<BI")

#: Fixed part of a RESET, STEP or AFTER message: flags (bit 0 terminated, bit 1 truncated, SAME, SAME_INFO), the three
#: value types, the reward, microseconds spent in the call, layout number, observation bytes, info bytes.
STEP = struct.Struct("<BBBBdIHII")

#: Fixed part of a RENDER or REREAD message: flags (SAME), layout number. The rest is the value.
VALUE = struct.Struct("<BH")

#: Flag of a value of which no bytes follow: it has the layout and the bytes of the last one of at least LONG bytes.
SAME = 4
LONG = 256
#: Flag of a step whose info is that of the step or reset before; no bytes follow for it.
SAME_INFO = 8

MAX_OBSERVATION = 8 * 1024 * 1024
MAX_INFO = 64 * 1024
#: Of a message that is JSON; spaces with their bounds, and the result of a search, can be long.
MAX_JSON = 256 * 1024
MAX_LONG_JSON = 4 * 1024 * 1024
MAX_LAYOUTS = 4096
MAX_PARTS = 100_000
MAX_DEPTH = 8
#: Of a dictionary, list or tuple, and of an array.
MAX_ITEMS = 4096
MAX_DIMENSIONS = 32


#: Of a job, which holds the source, and of what the fork server says.
MAX_MESSAGE = 16 * 1024 * 1024


class Kind(IntEnum):
    """What a message from a job is about."""

    PHASE = 1  #: JSON string: the call that is about to run (import, construct, reset, step, render, close, search)
    LOADED = 2  #: JSON object: what the file defines
    LAYOUT = 3  #: JSON object: the next observation layout
    RESET = 4  #: STEP struct, observation, info
    ACTION = 5  #: JSON: the action a policy inside the worker chose
    STEP = 6  #: STEP struct, observation, info
    AFTER = 7  #: like STEP, for a step taken after the episode's end
    RENDER = 8  #: VALUE struct, frame
    REREAD = 9  #: VALUE struct, the previous observation's bytes as they are now
    ACTED = 10  #: JSON object: the action before step() and as that left it
    FAULT = 11  #: JSON object: an exception, or a return value of the wrong form
    TICK = 12  #: empty: alive
    RESULT = 13  #: JSON object: what a search found
    #: JSON object: the job is complete; with "goes_on" its process waits for another one, "waits" counts the steps that
    #: gave up the processor
    END = 14
    ASK = 15  #: empty: the job waits for its next action
    STEPS = 16  #: STEP structs, each with SAME and SAME_INFO


#: The kinds whose payload begins with a fixed part and goes on with a value's bytes.
VALUED = frozenset((Kind.RESET, Kind.STEP, Kind.AFTER, Kind.RENDER, Kind.REREAD))


def longest(kind: int) -> int:
    """The most bytes that a message of this kind may have after its header."""
    if kind in VALUED:
        return STEP.size + MAX_OBSERVATION + MAX_INFO
    return MAX_LONG_JSON if kind in (Kind.LOADED, Kind.RESULT) else MAX_JSON


class Type(IntEnum):
    """The Python type of a reward or a flag, as the worker saw it."""

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
