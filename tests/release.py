"""Builds what is released, and tries it as its users will: `make release`.

Wheel and sdist are built twice, from two fresh clones of the last commit, and have to be
the same bytes. Each is then installed into an empty environment, first without the app's
packages and then with them, where the app has to answer, and the demo to be refined and
textured. What passes lies in dist/.
"""

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import urllib.request
import venv
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
_DEPENDENCIES = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "dependencies"
]
(OLDEST_NUMPY,) = (
    name.replace(">=", "==") for name in _DEPENDENCIES if name.startswith("numpy>=")
)
DEMO_PX = 0.1
"""How far off a refined demo may end; it ends at half of this."""


class ReleaseError(Exception):
    """What stands against the release, in a sentence."""


def main() -> int:
    """Builds and tries; returns the exit status."""
    try:
        with tempfile.TemporaryDirectory(prefix="photoreg-release-") as folder:
            built = build_twice(Path(folder))
            for path in built:
                print(f"Trying {path.name} ...", flush=True)
                try_out(path, Path(folder) / path.suffix.lstrip("."))
            DIST.mkdir(exist_ok=True)
            for path in built:
                shutil.copy(path, DIST)
                print(f"dist/{path.name}")
    except ReleaseError as error:
        print(f"No release: {error}", file=sys.stderr)
        return 1
    return 0


def build_twice(folder: Path) -> list[Path]:
    """Wheel and sdist of the last commit.

    Raises:
        ReleaseError: if not all is committed, or two builds differ.
    """
    if changed := output("git", "status", "--porcelain"):
        raise ReleaseError(f"these files are not committed:\n{changed}")
    first, second = (build(folder / name) for name in ("once", "again"))
    for one, other in zip(first, second, strict=True):
        if one.name != other.name or one.read_bytes() != other.read_bytes():
            raise ReleaseError(f"two builds of {one.name} are not the same bytes.")
    return first


def build(folder: Path) -> list[Path]:
    """Builds the sdist of a fresh clone, and the wheel of that sdist."""
    source, built = folder / "source", folder / "built"
    output("git", "clone", "--quiet", ROOT, source)
    committed = output("git", "log", "-1", "--format=%ct")
    output(
        *(sys.executable, "-m", "build", "--outdir", built, source),
        SOURCE_DATE_EPOCH=committed,
    )
    packages = sorted(built.iterdir())
    if [path.suffix for path in packages] != [".whl", ".gz"]:
        names = ", ".join(path.name for path in packages)
        raise ReleaseError(
            f"a wheel and an sdist were expected, but built was {names}."
        )
    return packages


def try_out(package: Path, folder: Path) -> None:
    """Installs a package into an empty environment, and uses it there.

    Raises:
        ReleaseError: if it does not do what it should.
    """
    venv.create(folder / "env", with_pip=True)
    programs = folder / "env" / "bin"
    work = folder / "work"
    work.mkdir()

    def run(*words: str | Path) -> str:
        program, *arguments = words
        return output(programs / program, *arguments, cwd=work)

    pip = ("pip", "install", "--quiet", "--disable-pip-version-check")
    # The wheel beside the oldest numpy, the sdist with the newest.
    beside = [OLDEST_NUMPY] if package.suffix == ".whl" else []
    run(*pip, package, *beside)
    told = refused(programs / "photoreg", work)
    if "pip install 'photoreg[app]'" not in told:
        raise ReleaseError(f"without the app's packages photoreg said: {told}")
    static = run(
        *("python", "-c"),
        "from photoreg.report.static_files import static_folder; print(static_folder())",
    )
    shutil.copytree(Path(static) / "demo", work, dirs_exist_ok=True)
    scan = ("shell.ply", "shell-left.jpg", "shell-right.jpg")
    run("photoreg", "refine", *scan, "--cameras", "rough.json", "--out", "refined.json")
    measured = run(
        *("photoreg", "evaluate", "shell.ply", "--json"),
        *("--cameras", "refined.json", "--truth", "cameras.json"),
    )
    if not (off := json.loads(measured)["mean_px"]) < DEMO_PX:
        raise ReleaseError(f"the demo ended {off:.3f} px off.")
    print(f"  The demo ends {off:.3f} px off.", flush=True)
    run("photoreg", "texture", *scan, "--cameras", "refined.json", "--out", "model.glb")
    if not (work / "model.glb").read_bytes().startswith(b"glTF"):
        raise ReleaseError("model.glb is no GLB.")
    run(*pip, f"photoreg[app] @ {package.as_uri()}")
    with (
        app(programs / "photoreg", work) as address,
        urllib.request.urlopen(address, timeout=60) as answer,
    ):
        page = answer.read()
    if answer.status != 200 or b"<html" not in page.lower():
        raise ReleaseError(f"the app answered with status {answer.status}.")
    print("  The app answers.", flush=True)


@contextlib.contextmanager
def app(program: Path, folder: Path) -> Iterator[str]:
    """The app, running, and its address."""
    with subprocess.Popen(
        [program, "app", "--no-browser", *("--port", "0", "--project", "project")],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                if found := re.search(r"photoreg is at (http://\S+)", line):
                    yield found[1]
                    break
            else:
                raise ReleaseError("the app ended by itself.")
        finally:
            process.terminate()


def output(*words: str | Path, cwd: Path = ROOT, **variables: str) -> str:
    """What a program prints.

    Raises:
        ReleaseError: if it fails, with all that it said.
    """
    done = subprocess.run(
        words,
        cwd=cwd,
        env={**environment(), **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        command = " ".join(map(str, words))
        raise ReleaseError(
            f"{command} ended with status {done.returncode}.\n{done.stdout}{done.stderr}"
        )
    return done.stdout.strip()


def refused(program: Path, folder: Path) -> str:
    """What a program says that refuses to start, in one line.

    Raises:
        ReleaseError: if it ends in another way than with status 2.
    """
    done = subprocess.run(
        [program],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 2:
        raise ReleaseError(f"{program.name} ended with status {done.returncode}.")
    return " ".join(done.stderr.split())


def environment() -> dict[str, str]:
    """Ours, without what would let a program find this checkout."""
    return {
        k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")
    }


if __name__ == "__main__":
    sys.exit(main())
