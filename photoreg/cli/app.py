"""`photoreg app`: starts the browser app that an entry point names.

No module of photoreg imports the app. A package that has one registers the function
that serves it in the entry-point group `photoreg.apps`.
"""

import importlib.metadata
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from photoreg.cli.stopping import ctrl_c_ends_at_once
from photoreg.errors import InputError

ENTRY_POINTS = "photoreg.apps"
BROWSER_APP = "browser"


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
        files: A mesh and its photos; or a folder that `photoreg synthesize` made, or one of
            an object that `photoreg batch` made.
        cameras: Cameras of the photos, a photoreg camera file.
        project: Folder in which the work is saved: an existing project is opened as it was
            left, otherwise one is made. Without it, a new one in your data folder.
        host: Address to listen on; by default only this machine can connect. Any other
            address requires a token.
        port: Port to listen on; the next free one is taken when it is busy.
        token: Password for the browser, at least 16 characters; better set in the
            environment variable PHOTOREG_TOKEN, which other users cannot see. Without
            it, one is made where it is needed.
        address: The address by which people reach it through a proxy, such as
            https://photos.example.org; see SECURITY.md.
        browser: Open the page in the default browser, where there is one.
    """
    return find_app()(
        files,
        cameras,
        project=project,
        host=host,
        port=port,
        token=token,
        address=address,
        open_browser=browser,
    )


def find_app() -> Callable[..., int]:
    """The function that serves the app until it is interrupted; it returns the exit status.

    Raises:
        InputError: if no app is installed, if packages that it needs are missing, or if
            another module has its name.
    """
    found = importlib.metadata.entry_points(group=ENTRY_POINTS, name=BROWSER_APP)
    if not found:
        raise InputError(
            "The browser app is not installed here. Install photoreg anew: "
            "pip install --force-reinstall 'photoreg[app]' (in a checkout: pip install "
            "--editable '.[app]')."
        )
    entry = next(iter(found))
    package = entry.module.partition(".")[0]
    try:
        with ctrl_c_ends_at_once():
            return entry.load()
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "photoreg"):
            raise
        if missing != package:
            raise InputError(
                f"The browser app needs {missing}, which is not installed; install the "
                "app's packages: pip install 'photoreg[app]' (in a checkout: pip install "
                "'.[app]')."
            ) from error
        raise InputError(
            f"The browser app could not be started: {error}. Another module named "
            f"{package} comes before it on Python's path; look for it in the folders "
            "that PYTHONPATH names."
        ) from error
