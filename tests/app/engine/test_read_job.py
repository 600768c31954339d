"""A decoder that dies takes nothing with it but its file."""

import multiprocessing
from pathlib import Path

from app.engine.read_job import ReadRequest, _pump
from app.model.messages import Failed, ReadAll, Reading, ReadingEvent


def _die(connection) -> None:
    connection.recv()
    connection.send(Reading("Reading p.dng", 0.0))
    connection.close()


def test_the_file_at_which_a_decoder_died_is_named():
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_die, args=(theirs,))
    process.start()
    theirs.close()
    events: list[ReadingEvent] = []
    _pump(process, ours, ReadRequest((Path("p.dng"),), None, {}), events.append)
    assert isinstance(events[-1], ReadAll)
    assert not events[-1].complete
    failed = events[-2]
    assert isinstance(failed, Failed)
    assert failed.message.startswith("Reading was cut short (Reading p.dng): ")
