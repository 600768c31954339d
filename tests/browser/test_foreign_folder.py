"""`photoreg app` where somebody's own modules have the names of ours and of Python's."""

import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from playwright.sync_api import Browser, expect

from tests.browser.driver import Driver

OWN = """
import os
import pathlib
with pathlib.Path(__file__).open("a") as own:
    own.write(f"# imported by {os.getpid()}\\n")
raise RuntimeError("this module is somebody's own")
"""
NAMES = ("app.py", "app/__init__.py", "app/page/__init__.py", "random.py")

PROGRAMS = {
    "module": [sys.executable, "-m", "photoreg"],
    "script": [str(Path(sys.executable).with_name("photoreg"))],
}


@pytest.mark.parametrize("program", list(PROGRAMS))
def test_the_app_its_worker_and_its_reader_are_ours_and_not_the_folder_s(
    chromium: Browser,
    toy_document,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    program: str,
) -> None:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    folder = tmp_path / "mine"
    for name in NAMES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(OWN)
    photo = tmp_path / "another.png"
    assert cv2.imwrite(str(photo), toy_document.photos[0].photo.pixels)
    command = [*PROGRAMS[program], "app", "--no-browser", "--port", "0"]
    log = tmp_path / "log.txt"
    with (
        log.open("w") as errors,
        subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process,
    ):
        try:
            assert process.stdout is not None
            address = None
            while address is None:
                line = process.stdout.readline()
                assert line, log.read_text()
                address = re.search(r"http://\S+", line)
            window = chromium.new_page(viewport={"width": 1100, "height": 700})
            driver = Driver(window, address.group().rstrip("/"))
            # The worker has compiled what it needs, and the reader reads.
            expect(window.get_by_role("status")).to_have_text("Ready.", timeout=60_000)
            driver.tab("1 Data")
            with window.expect_file_chooser() as chooser:
                driver.click("Open files …")
            chooser.value.set_files([photo])
            window.get_by_text("another.png").first.wait_for(timeout=60_000)
            window.close()
        finally:
            process.terminate()
            process.wait()
    for name in NAMES:
        assert (folder / name).read_text() == OWN, "it was imported"
    assert "Traceback" not in log.read_text()


def test_without_an_app_the_command_says_so(tmp_path: Path) -> None:
    program = (
        "import importlib.metadata, sys;"
        "importlib.metadata.entry_points = lambda **_: ();"
        "from photoreg.__main__ import main; sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "app"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "The browser app is not installed here." in done.stderr
    assert "Traceback" not in done.stderr


def test_another_app_before_ours_on_the_path_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "app.py").touch()
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    done = subprocess.run(
        [sys.executable, "-m", "photoreg", "app", "--no-browser"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    told = " ".join(done.stderr.split())
    assert "Another module named app comes before it on Python's path" in told
