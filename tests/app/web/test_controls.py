"""Guarded callbacks: what fails in them is told to one person, once, and to the log."""

import asyncio
import threading
import types
from collections.abc import Coroutine
from typing import Any

import pytest

from app.model.failures import UNFORESEEN
from app.web.controls import guarded, guarded_client, guarded_slow
from photoreg.errors import InputError


class Client:
    """A browser that remembers what it was told."""

    def __init__(self, number: int) -> None:
        self.client_id = number
        self.told: list[str] = []

    def add_notification(self, _title: str, text: str, **_: Any) -> None:
        self.told.append(text)


def _event(client: Client) -> Any:
    return types.SimpleNamespace(client=client)


def _run(callback: Coroutine[Any, Any, None]) -> None:
    """In a thread of its own: a browser test before may have left a loop in this one."""
    thread = threading.Thread(target=asyncio.run, args=(callback,))
    thread.start()
    thread.join()


def test_a_failure_twenty_times_a_second_is_one_message_and_one_line(caplog) -> None:
    first, second = Client(90_001), Client(90_002)

    @guarded
    def drag(_: Any) -> None:
        raise ZeroDivisionError("drag")

    for _ in range(20):
        _run(drag(_event(first)))
    assert first.told == [UNFORESEEN]
    assert len(caplog.records) == 1
    _run(drag(_event(second)))
    assert second.told == [UNFORESEEN], "each person is told"


@pytest.mark.parametrize("kind", ["quick", "slow", "client"])
def test_a_sentence_of_ours_reaches_the_person_and_not_the_log(
    kind: str, caplog
) -> None:
    client = Client(90_010 + len(kind))

    def refuse(_: Any) -> None:
        raise InputError("There is no photo 7.")

    if kind == "quick":
        _run(guarded(refuse)(_event(client)))
    elif kind == "slow":
        guarded_slow(refuse)(_event(client))
    else:
        guarded_client(refuse)(client)  # pyright: ignore[reportArgumentType]
    assert client.told == ["There is no photo 7."]
    assert not caplog.records
