"""Zips that lie: about where their files go, how many and how large they are."""

import io
import stat
import struct
import zipfile
from collections.abc import Iterator, Mapping

from tests.robustness.lying_input import Case
from tests.robustness.lying_meshes import ply
from tests.robustness.lying_photos import png

FILES = {"m.ply": ply(), "a.png": png()}


def packed(
    files: Mapping[str, bytes] = FILES, method: int = zipfile.ZIP_DEFLATED
) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return buffer.getvalue()


def zip_archive_cases() -> Iterator[Case]:
    """Zips as the app takes them: the mesh, photos and cameras are taken out."""
    both, name = "read: m.ply, a.png", "z.zip"
    yield Case("nothing wrong", name, packed(), both)
    yield Case("packed by LZMA", name, packed(method=zipfile.ZIP_LZMA), both)
    yield Case("bytes before and after it", name, b"ab" + packed() + b"cd", both)
    yield Case("empty", name, b"", "is empty (0 bytes)")
    yield Case("a zip of nothing", name, packed({}), "read: nothing")
    yield Case("noise", name, bytes(range(256)) * 9, "damaged, or not a zip")
    yield Case("cut at half", name, packed()[: len(packed()) // 2], "damaged")
    yield Case("cut near the end", name, packed()[:-30], "damaged")
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA):
        whole = bytearray(packed({"m.ply": ply()}, method))
        whole[60] ^= 0xFF
        yield Case(f"a byte changed, method {method}", name, bytes(whole), "damaged")

    def named(*names: str) -> bytes:
        return packed({each: ply() for each in names})

    yield Case("a file above its folder", name, named("../../m.ply"), "read: m.ply")
    yield Case("a file at /etc", name, named("/etc/m.ply"), "read: etc/m.ply")
    windows = named("C:\\Windows\\..\\..\\m.ply")
    yield Case("a file at C:\\Windows", name, windows, "read: C_/Windows/m.ply")
    yield Case("a file without a name", name, named("../.."), "read: nothing")
    yield Case("folders only", name, named("a/", "b/"), "read: nothing")
    yield Case("a hidden file", name, named(".ply"), "read: nothing")
    long = f"{'x' * 400}.ply"
    yield Case(
        "a name of 400 letters", name, named(long), "longer than the disk allows"
    )
    odd = named("Mäuse 模型 'a' \"b\".ply")
    yield Case("a name", name, odd, "read: Mäuse 模型 'a' \"b\".ply")
    yield Case(
        "a file as a folder", name, named("m.ply", "m.ply/n.ply"), "a folder's at once"
    )
    yield Case("a program and a page", name, named("a.exe", "b.html"), "read: nothing")
    yield Case("a zip within", name, packed({"b.zip": packed()}), "read: nothing")
    central = packed({"é.ply": ply()}).rpartition(b"PK\1\2")
    no_utf8 = b"".join(central[:2]) + central[2].replace("é".encode(), b"\xff\xfe")
    yield Case("a name that is no UTF-8", name, no_utf8, "damaged")
    yield Case("a name of no letters", name, nameless(), "read: nothing")
    link = zipfile.ZipInfo("m.ply")
    link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(link, "/etc/passwd")
    yield Case("a symbolic link", name, buffer.getvalue(), "read: m.ply")
    twice = named("m.ply", "n.ply").replace(b"n.ply", b"m.ply")
    yield Case("the same name twice", name, twice, "read: m.ply")
    encrypted = bytearray(packed({"m.ply": ply()}, zipfile.ZIP_STORED))
    for signature, at in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        encrypted[encrypted.index(signature) + at] |= 1
    yield Case("encrypted", name, bytes(encrypted), "is encrypted")
    yield Case("of a method that is none", name, of_method(97), "way that photoreg")
    bomb = packed({"m.ply": bytes(5_000_000)})
    yield Case("a bomb of 5 MB", name, bomb, "m.ply in z.zip would unpack to 5 MB")
    many = packed({f"{i}.ply": bytes(900_000) for i in range(5)})
    yield Case("five files of 0.9 MB", name, many, "z.zip would unpack to 4.5 MB")
    hidden = bytearray(bomb)
    sizes = struct.pack("<I", 5_000_000), struct.pack("<I", 1000)
    yield Case("a bomb that says 1 kB", name, bytes(hidden.replace(*sizes)), "damaged")
    crowd = packed({f"{i}.txt": b"" for i in range(20_001)}, zipfile.ZIP_STORED)
    yield Case("20,001 files", name, crowd, "more than 20,000 files")


def nameless() -> bytes:
    """A zip whose only file has a name that begins with a zero byte."""
    return packed({"m.ply": ply()}).replace(b"m.ply", b"\0.ply")


def of_method(number: int) -> bytes:
    whole = bytearray(packed({"m.ply": ply()}, zipfile.ZIP_STORED))
    for signature, at in ((b"PK\3\4", 8), (b"PK\1\2", 10)):
        struct.pack_into("<H", whole, whole.index(signature) + at, number)
    return bytes(whole)
