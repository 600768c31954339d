"""The container of binary glTF: a description in JSON, then the bytes that it names."""

import json
import struct
from typing import Any

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def glb_file(document: dict[str, Any], body: bytes) -> bytes:
    """A GLB file of a glTF document and its one buffer.

    References:
        Khronos Group, glTF 2.0 Specification, 2021, section 4.4.
    """
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    json_head = struct.pack("<II", len(text), JSON_CHUNK)
    return b"".join(
        [head, json_head, text, struct.pack("<II", len(body), BINARY_CHUNK), body]
    )
