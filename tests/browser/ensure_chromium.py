"""Makes sure that the browser tests have a Chromium; says in one sentence if not.

On Debian as root it is Debian's package, elsewhere the one playwright downloads.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def find_chromium() -> str | None:
    """The path of a Chromium to test with: the system's, else playwright's own."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        path = shutil.which(name)
        if path is not None:
            return path
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = playwright.chromium.executable_path
    return path if Path(path).exists() else None


def _install() -> None:
    if os.geteuid() == 0 and shutil.which("apt-get") is not None:
        print("Installing Debian's chromium for the browser tests (once) ...")
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for command in (
            ["apt-get", "update", "-qq"],
            ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "chromium"],
        ):
            subprocess.run(
                command, check=False, env=environment, stdout=subprocess.DEVNULL
            )
    else:
        print("Downloading playwright's chromium for the browser tests (once) ...")
        subprocess.run(
            [sys.executable, "-m", "playwright", "install", "chromium"], check=False
        )


def main() -> int:
    """Installs a Chromium if there is none; 0 when there is one in the end."""
    if find_chromium() is None:
        _install()
    if find_chromium() is None:
        print(
            "The browser tests need Chromium, and it could not be installed: install "
            "the package chromium, or run .venv/bin/playwright install chromium.",
            file=sys.stderr,
        )
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
