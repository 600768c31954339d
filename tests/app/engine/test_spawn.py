"""Processes beside the app: quick to start after the first, and quiet when it is killed."""

import os
import subprocess
import sys
from multiprocessing.connection import Connection

import numba
import pytest

from app.engine.spawn import spawned

KILLED = """
import os, signal
from multiprocessing import forkserver
from app.engine.spawn import spawned

def connect_and_die(fds, connect=forkserver.connect_to_new_process):
    connect(fds)
    os.kill(os.getpid(), signal.SIGKILL)

forkserver.connect_to_new_process = connect_and_die
spawned(print)
"""

ENDED = """
from app.engine.spawn import end, spawned
from tests.app.engine.test_spawn import compute

process, connection = spawned(compute)
assert connection.recv() == "computing"
end(process)
"""


def compute(connection: Connection) -> None:
    numba.get_num_threads()  # Starts numba's threads.
    connection.send("computing")
    connection.recv()


def tell(connection: Connection, name: str) -> None:
    connection.send((os.getpid(), os.environ.get(name), sys.excepthook.__module__))


def test_each_process_has_the_app_s_environment_of_its_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = []
    for value in ("1", "2"):
        monkeypatch.setenv("PHOTOREG_TRIAL", value)
        process, connection = spawned(tell, "PHOTOREG_TRIAL")
        told.append(connection.recv())
        process.join()
        assert process.exitcode == 0
    monkeypatch.delenv("PHOTOREG_TRIAL")
    process, connection = spawned(tell, "PHOTOREG_TRIAL")
    told.append(connection.recv())
    process.join()
    assert [value for _, value, _ in told] == ["1", "2", None]
    assert len({os.getpid(), *(pid for pid, _, _ in told)}) == 4
    assert {hook for _, _, hook in told} == {"sys"}


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is forked")
def test_an_app_that_is_killed_while_it_starts_a_process_leaves_no_traceback() -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED], capture_output=True, text=True, check=False
    )
    assert done.returncode < 0
    assert "Traceback" not in done.stderr


def test_a_process_that_is_ended_while_it_computes_leaves_nothing_and_no_warning() -> (
    None
):
    done = subprocess.run(
        [sys.executable, "-c", ENDED], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
