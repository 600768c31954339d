"""How viser notifies what sends to browsers, made safe for several threads.

viser 1.1.1 sets an asyncio event from whatever thread queues a message. Such an event is
its loop's alone: where several browsers wait for it, now and then the loop changed the
list of them meanwhile, and the message's sender got "deque mutated during iteration".
"""

import asyncio
from typing import Any

from viser.infra import Message, _infra
from viser.infra._async_message_buffer import AsyncMessageBuffer

from app.web.outgoing import sendable


class LoopEvent(asyncio.Event):
    """An event that is set in its loop only.

    viser also has its loop set it after each message, or where an atomic block ends.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._its_loop = loop

    def set(self) -> None:
        """Wakes all that wait; from another thread it does nothing."""
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            return
        if running is self._its_loop:
            super().set()


class ThreadSafeBuffer(AsyncMessageBuffer):
    """viser's buffer of messages, with an event that bears other threads."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.message_event = LoopEvent(self.event_loop)

    def push(self, message: Message) -> None:
        """Takes a message, unless the browser that it is for has left meanwhile."""
        if not self.done:
            super().push(sendable(message))


def use_thread_safe_buffers() -> None:
    """Has all servers and clients of viser made from now on use such buffers."""
    _infra.AsyncMessageBuffer = ThreadSafeBuffer  # pyright: ignore
