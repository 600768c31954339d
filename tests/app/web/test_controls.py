"""Guarded callbacks: what fails in them is told to one person, once, and to the log."""

import asyncio
import types
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from app.model.failures import UNFORESEEN
from app.web.controls import Typed, guarded, guarded_client, guarded_slow
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
    with ThreadPoolExecutor(max_workers=1) as pool:
        pool.submit(asyncio.run, callback).result()


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


class Box:
    """A field of numbers in a page, and what is typed into it."""

    def __init__(self, value: float) -> None:
        self.value = value

    def on_update(self, callback: Any) -> None:
        self._callback = callback

    async def type(self, client: Client, value: float) -> None:
        self.value = value
        await self._callback(_event(client))


def test_a_key_struck_while_the_key_before_is_shown_is_not_undone(monkeypatch) -> None:
    monkeypatch.setattr("app.web.controls.TYPING_REST_S", 0.05)
    client, box, taken = Client(90_020), Box(40.0), []

    def take(new: tuple[float | None, ...]) -> None:
        if new == (32.0,):
            raise InputError("An angle should be 3 or 32.5.")
        taken.append(new)

    typed = Typed(box, take)

    async def course() -> None:
        typed.show((40.0,))
        await box.type(client, 3.0)
        await box.type(client, 32.0)
        typed.show((3.0,))
        assert box.value == 32.0, "the value in force comes after the next key"
        await box.type(client, 32.5)
        typed.show((32.5004,))
        assert box.value == 32.5
        await asyncio.sleep(0.2)

    _run(course())
    assert taken == [(3.0,), (32.5,)]
    assert client.told == [], "32 was half typed"
    assert box.value == 32.5004, "what is in force is shown when typing has rested"


def test_a_refused_number_is_told_and_replaced_when_typing_has_rested(
    monkeypatch,
) -> None:
    monkeypatch.setattr("app.web.controls.TYPING_REST_S", 0.05)
    client, box = Client(90_021), Box(40.0)

    def take(_: tuple[float | None, ...]) -> None:
        raise InputError("An angle should be 1 to 120.")

    typed = Typed(box, take)

    async def course() -> None:
        typed.show((40.0,))
        await box.type(client, 400.0)
        assert client.told == []
        await asyncio.sleep(0.2)

    _run(course())
    assert client.told == ["An angle should be 1 to 120."]
    assert box.value == 40.0
