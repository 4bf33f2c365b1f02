"""The bytes that cross the trust boundary.

A *job* runs in one forked child of the worker. The host gives the child one end of a fresh socket pair. It sends one
JSON job and receives a stream of messages; if the child offers to continue, another job may follow. Every message is
``<u8 kind><u32 length><payload>``. Lengths are bounded, kinds are known, and nothing is unpickled or evaluated. An
interactive job requests each action with ASK and sends nothing until it has received the action: JSON of at most
MAX_JSON bytes, in a message of kind ACTION.

Steps cross in blocks of at most MAX_STEPS: one fixed record for each step, then the bytes of all observations, those of
all infos, and the actions that a policy inside the worker chose.

Observations travel as raw bytes with a *layout*: a JSON description of the value (dtype, shape, keys) that is sent once
and then named by its number. A long value with the same bytes as the last long one is only marked as repeated, and so
is an info. A *frame* is an array of uint8 whose values need no look, because every value is in the space; its layout
has the kind ``frame``. Only its digest is sent, 128-bit XXH3 seeded by its layout, and the picture itself where the
host says so.

This module imports only the standard library, which keeps the start of the command line and of the worker short.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .jobs import Pictures

HEADER = struct.Struct("<BI")

#: Head of a RESET, STEPS or AFTER message: number of records, bytes of the JSON list of actions at the end.
BLOCK = struct.Struct("<HI")
#: A record: flags, the three value types, the reward, microseconds spent in the call, layout number, bytes of the
#: observation, bytes of the info.
STEP = struct.Struct("<BBBBdIHII")

#: Fixed part of a RENDER message: flags (SAME, FRAME), layout number. The value follows.
VALUE = struct.Struct("<BH")

#: The flags of a record and of a value. SAME: no bytes, the value repeats layout and bytes of the last value of at
#: least LONG bytes. SAME_INFO: no info bytes, the info repeats that of the previous step or reset. FRAME: the value is
#: a digest and perhaps a picture. RENDERED: render() then returned the same frame.
TERMINATED, TRUNCATED, SAME, SAME_INFO, FRAME, RENDERED = 1, 2, 4, 8, 16, 32
FLAGS = 63

#: Payload of a RESOURCES message, see ``envcraft.model.trace.Resources``: resident bytes, allocated bytes, allocated
#: blocks, lines, written bytes, threads, open files, files, entries of bounded queues.
RESOURCES = struct.Struct("<QQQQQIIII")

#: Bytes of a digest.
DIGEST = 16
#: The shortest value that is marked as repeated, and the shortest frame.
LONG = 256

#: Steps in one message, and bytes of its values unless it has one step only.
MAX_STEPS = 64
MAX_BLOCK = 256 * 1024
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


#: Of a FIELDS message: fields, characters of a path and of a value, numbers of lines; and bytes of all these messages
#: of an episode.
MAX_FIELDS, MAX_PATH, MAX_SHOWN, MAX_FIELD_LINES = 1000, 200, 400, 2000
MAX_STATES_BYTES = 4 * 1024 * 1024
#: Starts that the search `enclosed` looks at.
MAX_LOOKS = 100

#: Bytes of a job, which has the source, and of a control message.
MAX_MESSAGE = 16 * 1024 * 1024


class Kind(IntEnum):
    """The kinds of messages from a job."""

    PHASE = 1  #: JSON string: the call that is about to run (import, construct, reset, step, render, close, search)
    LOADED = 2  #: JSON object: what the file defines
    LAYOUT = 3  #: JSON object: the next observation layout
    RESET = 4  #: a block of one record
    ACTION = 5  #: JSON, to an interactive job: the next action
    STEPS = 6  #: a block
    AFTER = 7  #: a block of one record, for a step taken after the episode's end
    RENDER = 8  #: VALUE struct, frame
    CHANGED = 9  #: JSON object: the number of an observation that changed after it was returned
    ACTED = 10  #: JSON object: an action that step() changed, before and after
    FAULT = 11  #: JSON object: an exception, or a return value of the wrong form
    TICK = 12  #: empty: the job is alive
    RESULT = 13  #: JSON object: the result of a search
    #: JSON object: the job is complete; see :class:`envcraft_protocol.jobs.End`
    END = 14
    ASK = 15  #: empty: the job waits for its next action
    SPACE = 16  #: JSON object: the name of a space that changed, its text before and now
    RESOURCES = 17  #: RESOURCES struct: what the process uses after a recorded episode
    #: JSON object: the fields of the environment's state that changed, and the lines that ran; see
    #: :class:`envcraft_protocol.jobs.Fields`
    FIELDS = 18


#: The kinds whose payload is a fixed part and the bytes of values.
VALUED = frozenset((Kind.RESET, Kind.STEPS, Kind.AFTER, Kind.RENDER))


def longest(kind: int) -> int:
    """The maximum length in bytes of the payload of a message of this kind."""
    if kind in VALUED:
        return BLOCK.size + MAX_STEPS * STEP.size + DIGEST + MAX_OBSERVATION + MAX_INFO + MAX_JSON
    return MAX_LONG_JSON if kind in (Kind.LOADED, Kind.RESULT, Kind.FIELDS) else MAX_JSON


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
    LIST = 9
    TUPLE = 10
    DICT = 11
    OTHER = 12

    @property
    def words(self) -> str:
        return {
            0: "bool", 1: "numpy.bool", 2: "int", 3: "numpy integer", 4: "float",
            5: "numpy floating", 6: "None", 7: "str", 8: "numpy.ndarray", 9: "list", 10: "tuple", 11: "dict",
            12: "another type",
        }[int(self)]  # fmt: skip


def array_identity(dtype: str, shape: tuple[int, ...]) -> bytes:
    """What identifies the layout of an array in digests, on both sides: XXH3 of it, 64 bits, is their seed."""
    return repr(("array", dtype, shape, "", [])).encode()


def is_shown(pictures: Pictures, number: int) -> bool:
    """Whether the picture of an observation is sent with its digest; 0 is the reset's."""
    return number < pictures["first"] or (number <= pictures["until"] and number % pictures["every"] == 0)
