"""The app as a program of its own, as it is in use."""

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

SERVER = """
import sys
from pathlib import Path
from app.page.main import run_app
if __name__ == "__main__":  # The worker process imports it again.
    folder, *files = map(Path, sys.argv[1:])
    run_app(
        files,
        project=folder,
        port=0,
        open_browser=False,
        shadows=False,
        surroundings=False,
    )
"""


@contextlib.contextmanager
def server(folder: Path, *files: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The app as a program of its own, and its address."""
    program = folder.with_name("server.py")
    program.write_text(SERVER)
    command = [sys.executable, str(program), str(folder), *map(str, files)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = None
            while found is None:
                line = process.stdout.readline()
                assert line, "the server ended by itself"
                found = re.search(r"http://\S+", line)
            yield process, found.group().rstrip("/")
        finally:
            process.kill()
