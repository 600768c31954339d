"""What cannot be sent, made so that it can.

A number of more than 64 bits, or half a character, ends the connection of every browser,
and of each that comes later. Neither should come this far: it is logged as an error of
ours, and the page is sent what is nearest to it.
"""

import copy
import dataclasses
import logging
from typing import Any

import msgspec
from viser.infra import Message

log = logging.getLogger(__name__)


def sendable(message: Message) -> Message:
    """The message, or a copy of it in which all can be sent."""
    try:
        msgspec.msgpack.encode(message.as_serializable_dict([]))
    except (OverflowError, UnicodeEncodeError) as error:
        log.error("A %s held what cannot be sent: %s", type(message).__name__, error)
        mended = copy.copy(message)
        for name, value in vars(message).items():
            setattr(mended, name, _mended(value))
        return mended
    return message


def _mended(value: Any) -> Any:
    match value:
        case bool():
            return value
        case int():
            return min(max(value, -(2**63)), 2**63 - 1)
        case str():
            return value.encode(errors="replace").decode()
        case list() | tuple():
            return type(value)(_mended(part) for part in value)
        case dict():
            return {_mended(key): _mended(part) for key, part in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        mended = copy.copy(value)
        for name, part in vars(value).items():
            object.__setattr__(mended, name, _mended(part))
        return mended
    return value
