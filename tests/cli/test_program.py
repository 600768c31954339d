"""`photoreg app` as somebody starts it: what it prints, and whom it lets in."""

import contextlib
import http.client
import json
import queue
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from app.control.autosave import DOCUMENT_TYPES
from photoreg.cli import commands
from photoreg.project.project import Project
from tests.bench.wire import listening

GIVEN = "a-token-of-the-tests-0123456789"


def _hear_signals() -> None:
    for name in ("SIGHUP", "SIGINT"):
        signal.signal(getattr(signal, name), signal.SIG_DFL)


@contextlib.contextmanager
def program(
    tmp_path: Path, *arguments: str
) -> Iterator[tuple[subprocess.Popen[str], list[str], int]]:
    """The program, the lines that it has printed by the time it serves, its port."""
    command = [sys.executable, "-m", "photoreg", "app", "--no-browser", "--port", "0"]
    work = ["--project", str(tmp_path / "work")]
    with subprocess.Popen(
        [*command, *work, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        # What runs under nohup ignores SIGHUP, and so would the program.
        preexec_fn=_hear_signals,  # noqa: PLW1509
    ) as process:
        assert process.stdout is not None
        try:
            lines: list[str] = []
            while not lines or "photoreg is at" not in lines[-1]:
                lines.append(process.stdout.readline())
                assert lines[-1], f"it ended by itself: {lines}"
            found = re.search(r":(\d+)", lines[-1])
            assert found is not None
            yield process, lines, int(found[1])
        finally:
            process.kill()


def status(port: int, path: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request("GET", path)
    with contextlib.closing(connection):
        return connection.getresponse().status


def test_for_other_machines_a_token_is_made_and_printed_once(tmp_path: Path) -> None:
    with program(tmp_path, "--host", "0.0.0.0") as (process, lines, port):
        found = re.search(rf"http://127.0.0.1:{port}(/\?token=([\w-]+)) ", lines[-1])
        assert found is not None
        assert len(found[2]) >= 32
        assert status(port, "/") == 403
        assert status(port, "/?token=" + "x" * len(found[2])) == 403
        assert status(port, found[1]) == 303
        process.send_signal(signal.SIGTERM)
        rest, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert rest.splitlines()[-1] == "Stopped."
        assert ("".join(lines) + rest).count(found[2]) == 1
    with program(tmp_path, "--host", "0.0.0.0") as (_, again, _):
        assert found[2] not in "".join(again), "each start makes its own"


def test_a_token_that_was_given_is_asked_for_and_not_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PHOTOREG_TOKEN", GIVEN)
    with program(tmp_path) as (process, lines, port):
        assert status(port, "/") == 403, "on this machine, too"
        assert status(port, f"/?token={GIVEN}") == 303
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert GIVEN not in "".join(lines) + rest


def test_alone_on_this_machine_it_asks_for_nothing(tmp_path: Path) -> None:
    with program(tmp_path) as (_, lines, port):
        assert f"photoreg is at http://127.0.0.1:{port} (Ctrl-C" in lines[-1]
        assert status(port, "/") == 200


@pytest.mark.parametrize("number", ["SIGHUP", "SIGTERM"])
def test_a_change_sent_in_the_moment_of_its_end_is_kept(
    tmp_path: Path, number: str
) -> None:
    bridge: queue.Queue[str] = queue.Queue()

    def hear(message: dict[str, Any]) -> None:
        if message["type"] == "GuiTextMessage" and message["props"]["label"] == "page":
            bridge.put(message["uuid"])

    words = {"act": "rename", "photo": "shell-left.jpg", "name": "renamed.jpg"}
    with program(tmp_path) as (process, _, port):
        with listening(f"http://127.0.0.1:{port}", hear) as send:
            update = {
                "type": "GuiUpdateMessage",
                "uuid": bridge.get(timeout=60.0),
                "updates": {"value": json.dumps({**words, "count": 1, "at": 1})},
            }
            send(msgspec.msgpack.encode(update))
            process.send_signal(getattr(signal, number))
            rest, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert rest.splitlines()[-1] == "Stopped."
    project = Project(tmp_path / "work", DOCUMENT_TYPES)
    first, steps, now = project.read_history()
    project.close()
    assert steps[now - first].document.photos[0].name == "renamed.jpg"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--host", "0.0.0.0", "--token", "short"], "at least 16 characters"),
        (["--address", "photos.example.org"], "https://photos.example.org"),
        (["--address", "https://example.org/photos"], "at the top of a host name"),
    ],
)
def test_unsafe_access_is_refused_in_a_sentence(
    arguments: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["app", "--no-browser", *arguments]
    assert commands.run(words) == 2
    assert sentence in " ".join(capfd.readouterr().err.split())


WITHOUT_THE_APP_S_PACKAGES = (
    "import sys; sys.modules.update(idna=None, platformdirs=None, viser=None);"
)


@pytest.mark.parametrize("arguments", [[], ["app", "mesh.ply"]])
def test_without_the_app_s_packages_a_sentence_says_what_to_install(
    tmp_path: Path, arguments: list[str]
) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            WITHOUT_THE_APP_S_PACKAGES
            + "from photoreg.__main__ import main; sys.exit(main())",
            *arguments,
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    told = " ".join(done.stderr.split())
    assert re.search(r"The browser app needs (idna|platformdirs|viser), which", told)
    assert "pip install 'photoreg[app]'" in told
    assert told.count(". ") == 0, "one sentence"
    assert "Traceback" not in told


def test_the_engine_needs_none_of_the_app_s_packages() -> None:
    program = (
        "import importlib, pkgutil, photoreg;"
        "names = [m.name for m in pkgutil.walk_packages(photoreg.__path__, 'photoreg.')];"
        "[importlib.import_module(n) for n in names if n != 'photoreg.__main__'];"
        "print(len(names))"
    )
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_THE_APP_S_PACKAGES + program],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100
