"""Fuzzing: every reader, fed damaged files for a stated time.

    python -m tests.robustness.fuzz 60            # a minute each
    python -m tests.robustness.fuzz 300 ply json  # five minutes each of two

Hypothesis damages sound files: it cuts, repeats, swaps and overwrites pieces, and puts
in words, numbers and bytes that such files know. Anything but a good value or an error
of photoreg's own is a failure, and so is a file that takes seconds; the smallest
example found is printed, and kept in build/fuzz/.
"""

import argparse
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pillow_heif
import pillow_jxl
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from photoreg.errors import PhotoregError
from photoreg.formats.meshes.packed import pack
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.project.check import CheckedProject
from tests.formats.photo_files import write_dng
from tests.robustness import (
    lying_archives,
    lying_cameras,
    lying_foreign,
    lying_input,
    lying_meshes,
    lying_photos,
    lying_projects,
)
from tests.robustness.memory import peak_memory_gb

EXAMPLES = 200
"""Files a round; rounds go on until the time is up."""

SLOW_S = 5.0
HANG_S = 20
MEMORY_BYTES = 6 << 30
"""A file that asks for more fails here, and would slow a machine elsewhere."""

KEPT = Path(__file__).parents[2] / "build" / "fuzz"

Content = Mapping[str, bytes]
"""The files of one input, by name."""

WORDS = [
    *(b"nan", b"-inf", b"1e308", b"-1", b"0", b"4294967295", b"1e-320", b"99999999999"),
    *(
        b"\n",
        b" ",
        b"\r\n",
        b"#",
        b"\0",
        b'"',
        b"[",
        b"]",
        b"{",
        b"}",
        b",",
        b"null",
        b"true",
    ),
    *(
        b"element vertex ",
        b"property list uchar int ",
        b"list char float",
        b"end_header\n",
    ),
    *(b"f 1/2/3 ", b"v ", b"vt ", b"vn ", b"mtllib ", b"usemtl ", b"endsolid", b"OFF"),
    *(b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"\xff\xd8", b"IHDR"),
    *(
        b'"children": [0]',
        b'"count": 1e9',
        b"!!opencv-matrix",
        b"<MLMatrix44>",
        b"%YAML",
        b"PK\1\2",
        b"../",
        b'{"at":"',
        b'"is":"Photo"',
        b"CREATE VIEW",
        b"Infinity",
    ),
]


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Sound bytes with up to six pieces changed."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        length = draw(st.integers(0, 40))
        kind = draw(st.sampled_from(("cut", "bytes", "word", "again", "bit", "end")))
        if kind == "cut":
            del data[at : at + length]
        elif kind == "bytes":
            new = draw(st.binary(max_size=12))
            data[at : at + len(new)] = new
        elif kind == "word":
            data[at : at + draw(st.integers(0, 8))] = draw(st.sampled_from(WORDS))
        elif kind == "again":
            data[at:at] = data[at : at + length]
        elif kind == "bit" and data:
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "end":
            del data[at:]
    return bytes(data)


@st.composite
def damaged_row(draw: st.DrawFn, content: bytes) -> bytes:
    """A sound database in which one value is another, all else being in order."""
    tables = lying_projects.tables(content)
    table = draw(st.sampled_from([name for name, rows in tables.items() if rows]))
    row = draw(st.integers(0, len(tables[table]) - 1))
    column = draw(st.integers(0, len(tables[table][row]) - 1))
    old = tables[table][row][column]
    value: Any
    if isinstance(old, str | bytes) and draw(st.booleans()):
        value = draw(damaged(old if isinstance(old, bytes) else old.encode()))
        if isinstance(old, str):
            value = value.decode(errors="replace")
    else:
        numbers = st.integers(-(2**63), 2**63 - 1) | st.floats()
        value = draw(st.none() | numbers | st.text(max_size=9) | st.binary(max_size=9))
    return lying_projects.with_value(content, table, row, column, value)


def camera_files(kind: str) -> Content:
    """What photoreg writes in a format, by path from the folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = lying_cameras.saved(folder / lying_cameras.SAVED[kind], kind)
        return {str(f.relative_to(folder)): f.read_bytes() for f in files}


def made(case: lying_input.Case) -> Content:
    """The files of a case of the table, the one that is read first."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "in" / case.name
        path.parent.mkdir()
        if isinstance(case.content, bytes):
            path.write_bytes(case.content)
        else:
            case.content(path)
        others = [p for p in path.parent.rglob("*") if p.is_file() and p != path]
        return {
            str(p.relative_to(path.parent)): p.read_bytes() for p in (path, *others)
        }


def packed_mesh(obj: bytes, mtl: bytes) -> bytes:
    """An OBJ with what it names, as the app keeps it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        contents = {"m.obj": obj, "m.mtl": mtl, "t.png": lying_photos.png()}
        for path, content in contents.items():
            (folder / path).write_bytes(content)
        mesh, *beside = (folder / path for path in contents)
        pack(mesh, beside, folder / "m.meshzip")
        return (folder / "m.meshzip").read_bytes()


def targets() -> dict[str, list[Content]]:
    """Sound files for each reader."""
    pillow_heif.register_heif_opener()
    assert pillow_jxl  # Both, so that Pillow writes what is damaged here.
    textured = (
        b"mtllib m.mtl\n"
        + lying_meshes.obj()
        + b"vt 0 0\nvt 1 0\nusemtl a\nf 1/1 2/2 3/1\n"
    )
    mtl = b"newmtl a\nKd 1 1 1\nmap_Kd t.png\n"
    normals = "property float nx\nproperty float ny\nproperty float nz\n"
    vertices = np.hstack([lying_meshes.V, lying_meshes.V + 1.0])
    found: dict[str, list[Content]] = {
        "obj": [
            {"m.obj": lying_meshes.obj()},
            {"m.obj": textured, "m.mtl": mtl, "t.png": lying_photos.png()},
        ],
        "ply": [
            {"m.ply": lying_meshes.ply()},
            {"m.ply": lying_meshes.ply(ascii_=True)},
            {"m.ply": lying_meshes.ply(vertices, extra=normals)},
        ],
        "stl": [{"m.stl": lying_meshes.stl()}, {"m.stl": lying_meshes.stl_text()}],
        "glb": [{"m.glb": lying_meshes.glb()}],
        "off": [{"m.off": lying_meshes.off()}],
        "jpeg": [
            {
                "p.jpg": lying_photos.encoded(
                    lying_photos.picture(),
                    "JPEG",
                    exif=lying_photos.exif(orientation=6),
                )
            },
            {
                "p.jpg": lying_photos.encoded(
                    lying_photos.picture("CMYK"), "JPEG", progressive=True
                )
            },
        ],
        "png": [
            {"p.png": lying_photos.png()},
            {"p.png": lying_photos.png("LA")},
            {"p.png": lying_photos.png_rgb16()},
        ],
        "tiff": [
            {"p.tif": lying_photos.encoded(lying_photos.picture(), "TIFF")},
            {
                "p.tif": lying_photos.encoded(
                    lying_photos.picture("RGBA"), "TIFF", compression="tiff_lzw"
                )
            },
        ],
    }
    for suffix, kind in (("webp", "WEBP"), ("avif", "AVIF"), ("heic", "HEIF")):
        found[suffix] = [
            {f"p.{suffix}": lying_photos.encoded(lying_photos.picture(), kind)}
        ]
    with tempfile.TemporaryDirectory() as folder:
        write_dng(Path(folder) / "p.dng", np.full((32, 48, 3), 0.5))
        found["dng"] = [{"p.dng": (Path(folder) / "p.dng").read_bytes()}]
    found["jxl"] = [{"p.jxl": lying_photos.encoded(lying_photos.picture(), "JXL")}]
    found["zip"] = [
        {
            "z.zip": lying_archives.packed(
                {"in a folder/m.ply": b"p" * 50, "a.png": b""}
            )
        },
        {"z.zip": lying_archives.packed(method=zipfile.ZIP_STORED)},
        {"z.zip": lying_archives.packed(method=zipfile.ZIP_LZMA)},
    ]
    for kind in lying_cameras.SAVED:
        found[kind] = [camera_files(kind)]
    for case in lying_foreign.foreign_cases():
        if case.expected.startswith("read:") and case.name.startswith("m."):
            found[case.name.removeprefix("m.")].append(made(case))
    found["meshzip"] = [{"m.obj.meshzip": packed_mesh(textured, mtl)}]
    found["project"] = [lying_projects.project_files()]
    return found


def outcome(files: Content, folder: Path) -> str:
    """Writes one input to a folder and reads it; raises what the reader lets through."""
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    started = time.process_time()
    # Ends the process: compiled readers that hang come back to no Python.
    signal.alarm(HANG_S)
    try:
        first = folder / Path(next(iter(files))).parts[0]
        if first.name == lying_projects.FOLDER:
            value = lying_projects.read(first)
        else:
            value = lying_input.read_path(first)
    except PhotoregError:
        return "refused"
    finally:
        signal.alarm(0)
        spent = time.process_time() - started
        assert spent < SLOW_S, f"reading took {spent:.1f} s of processor time"
    check(value)
    return "read"


def check(value: Any) -> None:
    """What is read must be of use: finite, in range, named."""
    if isinstance(value, Mesh):
        assert np.isfinite(value.vertices).all()
        assert np.isfinite(value.area)
        assert np.isfinite(value.vertex_normals).all()
        assert value.diagonal > 0.0
        for extra in (value.own_normals, value.vertex_colours):
            assert extra is None or len(extra) == len(value.vertices)
    elif isinstance(value, Photo):
        assert value.pixels.dtype == np.uint8
        assert value.exif_focal_px is None or value.exif_focal_px > 0.0
    elif isinstance(value, CheckedProject):
        assert value.steps or not value.loaded
    elif isinstance(value, list):
        assert all(path.is_file() for path in value)
    else:
        for name, camera in value.cameras.items():
            assert "/" not in name
            assert np.isfinite(camera.P).all()
            assert np.isfinite(camera.center).all()


def fuzz(name: str, seconds: float) -> int:
    """Rounds until the time is up; the exit status. The last input stays on disk."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    warnings.simplefilter("error")
    inputs = targets()[name]
    shutil.rmtree(KEPT / name, ignore_errors=True)
    (KEPT / name).mkdir(parents=True)
    for photo in ("a.png", "b.png"):
        (KEPT / name / photo).write_bytes(lying_photos.png())
    counts = {"read": 0, "refused": 0}
    end = time.monotonic() + seconds

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
        phases=(Phase.generate, Phase.shrink),
        print_blob=False,
    )
    @given(st.data())
    def one_round(data: st.DataObject) -> None:
        files = dict(data.draw(st.sampled_from(inputs)))
        if name == "project":
            victim = lying_projects.DATABASE_PATH
            damage = data.draw(st.sampled_from((damaged, damaged_row)))
        else:
            victim, damage = data.draw(st.sampled_from(sorted(files))), damaged
        files[victim] = data.draw(damage(files[victim]))
        counts[outcome(files, KEPT / name)] += 1

    failure = None
    while time.monotonic() < end and failure is None:
        try:
            one_round()
        except Exception as error:  # noqa: BLE001 - this is what it looks for.
            failure = error
    print(
        f"{name:12} {sum(counts.values()):7} files, {counts['read']:6} of them read; "
        f"largest memory {1000 * peak_memory_gb():.0f} MB"
    )
    # Several different ones come as a group.
    for each in getattr(failure, "exceptions", (failure,)) if failure else ():
        print(f"{type(each).__name__}: {each}")
    return 0 if failure is None else 1


def show(name: str, status: int) -> None:
    """Prints the input that the reader failed at."""
    how = "failed" if status > 0 else f"died by {signal.Signals(-status).name}"
    print(f"FAILED: {name} {how} at this input, kept in {KEPT / name}:")
    for path in sorted((KEPT / name).rglob("*")):
        if path.is_file() and path.name not in ("a.png", "b.png"):
            print(f"  {path.name}: {path.read_bytes()[:2000]!r}")


def main(options: argparse.Namespace) -> int:
    """Fuzzes the readers that were named, or all, each in a process of its own."""
    if options.here:
        return fuzz(options.readers[0], options.seconds)
    chosen = options.readers or list(targets())
    if unknown := set(chosen) - set(targets()):
        sys.exit(f"There is no reader {', '.join(sorted(unknown))}.")
    good = True
    for name in chosen:
        command = [
            sys.executable,
            "-m",
            "tests.robustness.fuzz",
            str(options.seconds),
            name,
        ]
        status = subprocess.run([*command, "--here"], check=False).returncode
        if status:
            good = False
            show(name, status)
    return 0 if good else 1


def command_line() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description="Feeds damaged files to every reader.")
    parser.add_argument("seconds", type=float, nargs="?", default=60.0)
    parser.add_argument("readers", nargs="*", help="all, if none is named")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main(command_line()))
