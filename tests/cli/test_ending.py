"""How commands end when something outside goes wrong: a sentence, never a traceback."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

from photoreg.cli import commands, scene
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.registry import write_cameras
from tests.painted import cameras_around

DEMO = Path(__file__).parents[2] / "static" / "demo"
EVALUATE = [
    *(sys.executable, "-m", "photoreg", "evaluate", str(DEMO / "shell.ply")),
    *("--cameras", str(DEMO / "rough.json"), "--truth", str(DEMO / "cameras.json")),
]


def ended(shell: str) -> subprocess.CompletedProcess[str]:
    """What a shell says of a line in which $EVALUATE is the command."""
    words = ["bash", "-c", f'"$@" {shell}', "bash", *EVALUATE]
    return subprocess.run(words, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("seconds", [0.4, 0.9, 1.3, 1.6, 2.0, 2.4])
@pytest.mark.parametrize("command", ["evaluate", "app"])
def test_ctrl_c_in_the_first_seconds_is_one_line(
    tmp_path: Path, command: str, seconds: float
) -> None:
    words = EVALUATE
    if command == "app":
        work = ["--project", str(tmp_path / "work"), "--no-browser", "--port", "0"]
        words = [sys.executable, "-m", "photoreg", "app", *work]
    # A group of its own, all of which hears Ctrl-C as in a terminal.
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
        # Shells have what runs in the background ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    ) as process:  # fmt: skip
        time.sleep(seconds)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        try:
            said, complaint = process.communicate(timeout=60)
        finally:
            process.kill()
    assert "Traceback" not in complaint + said, complaint
    assert process.returncode in (0, 1), complaint
    if process.returncode == 1:
        assert complaint == "Stopped.\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_under_standard_output_is_one_sentence() -> None:
    done = ended(">/dev/full")
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_reader_that_has_seen_enough_is_no_fault() -> None:
    done = ended("--json | head -c 1")
    assert (done.stdout, done.stderr) == ("{", "")


@pytest.mark.skipif(sys.platform != "linux", reason="the figures are Linux's")
def test_too_little_address_space_is_told_before_a_library_crashes() -> None:
    for kilobytes in (300_000, 1_000_000):
        words = ["bash", "-c", f'ulimit -v {kilobytes}; "$@"', "bash", *EVALUATE]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 2, done.stderr
        assert "GB of address space" in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (MemoryError(), 2, "There is not enough memory for this"),
        (
            OSError(errno.EMFILE, "Too many open files", "x"),
            2,
            "Too many files are open",
        ),
        (OSError(errno.EIO, "Input/output error", "x"), 2, "x could not be read or"),
        (BrokenPipeError(), 1, ""),
        (KeyboardInterrupt(), 1, "Stopped."),
    ],
)
def test_what_the_system_refuses_is_said_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    sentence: str,
) -> None:
    def fails(_: object) -> None:
        raise error

    monkeypatch.setattr(scene, "load_mesh", fails)
    monkeypatch.setattr(commands, "_drop_output", lambda: None)
    assert commands.run(EVALUATE[3:]) == status
    said = capfd.readouterr().err
    assert sentence in said
    assert said.count("\n") == (1 if sentence else 0)


@pytest.mark.parametrize(
    "name", [r"\N.py", r"\x.py", '"""; import os #.py', "a\nraise SystemExit\n.py"]
)
def test_a_blender_script_is_python_whatever_its_name_and_its_photos_are(
    tmp_path: Path, name: str
) -> None:
    folder = tmp_path / r"\N{oops} \U ''' \""
    folder.mkdir()
    photo = folder / "left.png"
    Image.new("RGB", (64, 48)).save(photo)
    camera = cameras_around(1, 64, 48)[0]
    given = CameraSet({photo.name: camera}, {photo.name: photo})
    write_cameras(tmp_path / name, given, "blender")
    text = (tmp_path / name).read_text(encoding="utf-8")
    compile(text, "script", "exec")
    start, end = text.index("CAMERAS ="), text.index("def folder")
    space: dict[str, object] = {}
    exec("import json\n" + text[start:end], space)
    entries = space["CAMERAS"]
    assert isinstance(entries, list)
    assert (tmp_path / entries[0]["path"]).samefile(photo)
