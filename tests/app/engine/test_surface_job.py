"""The object with its photos laid on, as the page gets it while a run goes on."""

import json

import cv2
import numpy as np

from app.engine.surface_job import LiveSurface
from app.engine.warm_up import toy_scene
from app.model.camera_moves import DisplayFrame
from app.model.messages import SMALL_PX
from app.web.photo_server import PhotoServer
from photoreg.imaging.photo import Photo

COMPONENTS = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_glb(content: bytes) -> tuple[dict, list[np.ndarray]]:
    """The document of a GLB file and its arrays, (n, width), normalised ones in [0, 1]."""
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    body = content[28 + length :]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = COMPONENTS[accessor["componentType"]]
        part = body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        values = np.frombuffer(part, dtype).reshape(-1, WIDTHS[accessor["type"]])
        assert len(values) == accessor["count"]
        arrays.append(values / 65535.0 if accessor.get("normalized") else values)
    return document, arrays


def test_each_face_wears_the_photo_at_the_place_where_its_camera_puts_it():
    mesh, photos, cameras = toy_scene()
    addresses = ("/photoreg/photo/7/small.jpg", "/photoreg/photo/8/small.jpg")
    surface = LiveSurface(mesh, photos, addresses, DisplayFrame.of(mesh))
    document, arrays = read_glb(surface.glb(cameras, "photos"))
    assert [image["uri"] for image in document["images"]] == list(addresses)
    primitives = document["meshes"][0]["primitives"]
    faces = [arrays[p["indices"]].reshape(-1, 3) for p in primitives]
    assert sorted(map(tuple, np.concatenate(faces))) == sorted(map(tuple, mesh.faces))
    for part, primitive, photo, camera in zip(
        faces, primitives, photos, cameras, strict=False
    ):
        assert len(part) > 100
        uv = arrays[primitive["attributes"]["TEXCOORD_0"]][part.ravel()]
        pixels = uv * (photo.width, photo.height) - 0.5
        expected = camera.project(mesh.vertices[part.ravel()])
        off = np.abs(pixels - expected).max()
        assert off < 0.01, f"{off:.4f} px"


def test_the_photos_are_fetched_reduced_and_keys_are_no_other_server_s():
    photo = Photo("wide.png", np.zeros((500, 1000, 3), np.uint8))
    ours, theirs = PhotoServer(), PhotoServer()
    address = ours.address(photo, "small")
    found = ours.find(address)
    assert found is not None
    kind, data = found
    assert kind == "image/jpeg"
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (SMALL_PX // 2, SMALL_PX, 3)
    assert theirs.address(photo, "small") != address
