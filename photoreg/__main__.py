"""`photoreg`: the app when no command is named, else the command line."""

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from photoreg.errors import InputError
from photoreg.limits import check_address_space


@contextlib.contextmanager
def _ctrl_c_ends_at_once() -> Iterator[None]:
    """While there is nothing to clean up: among imports, a KeyboardInterrupt is lost."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # A shell starts background programs deaf to Ctrl-C.
        return

    def end(*_: object) -> None:
        with contextlib.suppress(OSError):
            os.write(2, b"Stopped.\n")
        os._exit(1)

    signal.signal(signal.SIGINT, end)
    yield
    signal.signal(signal.SIGINT, signal.default_int_handler)


try:
    check_address_space()
except InputError as error:
    sys.stderr.write(f"photoreg: {error}\n")
    sys.exit(2)
with _ctrl_c_ends_at_once():
    # They take a second or two.
    import tyro

    from photoreg.cli import commands


def app_command(
    files: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="MESH PHOTO PHOTO | FOLDER"),
    ] = (),
    /,
    *,
    cameras: Path | None = None,
    project: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    address: str | None = None,
    browser: bool = True,
) -> int:
    """Open the app in the browser; without files, on the demo.

    Args:
        files: A mesh and its photos, or a folder that `photoreg synthesize` made.
        cameras: Cameras of the photos, a photoreg camera file.
        project: Folder that keeps the work: opened as it was left where it is a project,
            made where not. Without it, a new one in your data folder.
        host: Address to listen on; the default lets only this machine in. Any other asks
            for a token.
        port: Port to listen on; the next free one is taken when it is busy.
        token: What lets a browser in, at least 16 characters; better given by the
            environment variable PHOTOREG_TOKEN, which other users cannot see. Without
            it, one is made where it is needed.
        address: Where people reach it through a proxy, https://photos.example.org; see
            SECURITY.md.
        browser: Open the page in the default browser, where there is one.
    """
    # Not at the top: the command line must not wait for the app's imports.
    from app.page.main import run_app  # noqa: PLC0415

    return run_app(
        files,
        cameras,
        project=project,
        host=host,
        port=port,
        token=token,
        address=address,
        open_browser=browser,
    )


def main() -> int:
    """Runs the command that the terminal names; returns the exit status."""
    status = commands.run(sys.argv[1:] or ["app"], {"app": app_command})
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # What is left is the interpreter's own end.
        signal.signal(signal.SIGINT, lambda *_: os._exit(status))
    return status


if __name__ == "__main__":
    sys.exit(main())
