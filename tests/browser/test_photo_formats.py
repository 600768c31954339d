"""Photos as phones and cameras write them, from the page's drop to the texture."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import Image

from app.model.state import Document
from photoreg.formats.cameras.cameras_json import CameraFile, dump_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.models.ply import ply_bytes
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import SurfaceSamples
from photoreg.geometry.visibility import visible
from tests.browser.driver import wait_until
from tests.browser.own_files import drop
from tests.formats.photo_files import DISPLAY_P3, coded, icc_profile, write_dng
from tests.painted import ball_and_moon, cameras_around, paint, photograph

TURNS = {1: 0, 3: 2, 6: 1, 8: 3}
"""EXIF orientation to the quarter turns, against the clock, from shown to stored."""


def jpeg_in_p3(pixels: np.ndarray) -> bytes:
    wide = np.rint(255.0 * coded(pixels / 255.0, DISPLAY_P3, None)).astype(np.uint8)
    file = io.BytesIO()
    profile = icc_profile(DISPLAY_P3, None)
    Image.fromarray(wide).save(
        file, "JPEG", quality=97, subsampling=0, icc_profile=profile
    )
    return file.getvalue()


def heic(pixels: np.ndarray, orientation: int) -> bytes:
    pillow_heif.register_heif_opener()
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored = np.ascontiguousarray(np.rot90(pixels, TURNS[orientation]))
    file = io.BytesIO()
    Image.fromarray(stored).save(file, "HEIF", quality=95, exif=exif.tobytes())
    return file.getvalue()


def dng(pixels: np.ndarray, folder: Path) -> bytes:
    write_dng(folder / "p.dng", pixels / 255.0)
    return (folder / "p.dng").read_bytes()


def files(
    names: list[str], folder: Path
) -> tuple[dict[str, bytes], Mesh, list[Camera]]:
    """A painted ball, its photos in the formats of their names, and their cameras."""
    mesh, cameras = ball_and_moon(3), cameras_around(len(names), 360, 272)
    made = {"ball.ply": ply_bytes(mesh)}
    for name, camera in zip(names, cameras, strict=True):
        pixels = photograph(mesh, camera).pixels
        match Path(name).suffix:
            case ".HEIC":
                made[name] = heic(pixels, int(name[4]))
            case ".dng":
                made[name] = dng(pixels, folder)
            case _:
                made[name] = jpeg_in_p3(pixels)
    by_name = dict(zip(names, cameras, strict=True))
    made["cameras.json"] = dump_cameras(CameraFile(by_name)).encode()
    return made, mesh, cameras


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(["IMG_6.HEIC", "wide.jpg"], id="two"),
        pytest.param(
            [
                "IMG_1.HEIC",
                "IMG_3.HEIC",
                "IMG_6.HEIC",
                "IMG_8.HEIC",
                "a.dng",
                "wide.jpg",
            ],
            id="all",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_photos_of_phones_and_cameras_come_out_in_place_and_in_colour(
    names, open_app, tmp_path
):
    app = open_app(Document())
    made, mesh, cameras = files(names, tmp_path)
    drop(app.driver, made)
    wait_until(lambda: len(app.state.document.photos) == len(names), "all is open", 60)
    for entry in app.state.document.photos:
        assert (entry.photo.width, entry.photo.height) == (360, 272), entry.name
    app.driver.tab("4 Export")
    app.driver.click("Make the texture")
    wait_until(lambda: app.state.texture is not None, "the texture is made", 120)
    shares = {name: share for name, share, _ in app.state.texture.coverage}
    assert sorted(shares) == sorted(names)
    assert min(shares.values()) > 0.02, shares
    with app.driver.page.expect_download() as download:
        app.driver.click("Download the model")
    download.value.save_as(tmp_path / "model.zip")
    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        archive.extractall(tmp_path / "model")
    (obj,) = (tmp_path / "model").rglob("*.obj")
    difference = colour_difference(load_mesh(obj), mesh, cameras)
    # Of 255. What hardly turns up as a median would show a photo upside down.
    assert np.median(difference) < 4.0, np.percentile(difference, [50, 90, 99])
    assert np.percentile(difference, 90) < 12.0, np.percentile(difference, [50, 90, 99])


def colour_difference(model: Mesh, mesh: Mesh, cameras: list[Camera]) -> np.ndarray:
    """How far the texture is from the paint, at the middles of faces seen well."""
    np.testing.assert_array_equal(model.faces, mesh.faces)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    samples = SurfaceSamples(middles, mesh.face_normals, np.arange(len(middles)))
    seen = visible(samples, cameras, mesh, "rays", 0.5).any(axis=0)
    assert seen.sum() > 200
    assert model.corner_uv is not None
    assert model.own_texture is not None
    height, width = model.own_texture.shape[:2]
    u, v = model.corner_uv.mean(axis=1)[seen].T
    texel = model.own_texture[
        np.minimum(((1.0 - v) * height).astype(int), height - 1),
        np.minimum((u * width).astype(int), width - 1),
    ]
    return np.abs(texel.astype(float) - paint(middles[seen])).mean(axis=1)
