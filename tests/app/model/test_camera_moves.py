"""First cameras, focal length and the page's frame."""

import dataclasses

import numpy as np
import pytest

from app.engine.scene_opening import open_files, open_folder
from app.engine.warm_up import toy_scene
from app.model.camera_moves import (
    DisplayFrame,
    first_camera,
    nudged,
    rolled,
    up_of,
    with_focal,
)
from app.scene.canvas import fitting_focal, warped_photo
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import KnownLens, Photo


@pytest.fixture(scope="module")
def camera() -> Camera:
    # fx != fy, principal point off the centre, skew, rolled and turned.
    base = Camera.look_at((3, 1, 2), (0.2, 0.1, 0), (0.1, 1, 0.2), 700.0, 640, 480)
    K = np.array([[700.0, 2.0, 290.0], [0.0, 640.0, 265.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(base, K=K)


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    # Micrometres, far from the origin: nothing may depend on units.
    rock = toy_scene()[0]
    return Mesh(rock.vertices * 4e4 + np.array([1e6, -3e5, 2e5]), rock.faces)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (480, 640), (2000, 300)])
@pytest.mark.parametrize("focal_px", [None, 300.0, 5000.0])
def test_a_first_camera_has_the_whole_object_in_its_frame(
    mesh, width, height, focal_px
):
    photo = Photo(
        "a.jpg", np.zeros((height, width, 3), np.uint8), exif_focal_px=focal_px
    )
    camera = first_camera(mesh, photo, (0, 1, 0))
    pixels = camera.project(mesh.vertices)
    assert camera.contains(pixels).all()
    fill = np.ptp(pixels, axis=0) / (width, height)
    assert 0.6 < fill.max() < 0.85, f"fills {fill} of the frame"
    assert focal_px is None or camera.focal_px == focal_px


def test_a_first_camera_has_the_lens_that_is_known_and_stands_where_it_would(mesh):
    photo = Photo("a.jpg", np.zeros((480, 640, 3), np.uint8))
    lens = Lens(k1=-0.07, k2=0.02)
    plain = first_camera(mesh, photo, (0, 1, 0))
    photo = dataclasses.replace(photo, known_lens=KnownLens(lens, "50 mm"))
    camera = first_camera(mesh, photo, (0, 1, 0))
    assert camera.lens == lens
    assert plain.lens.is_ideal
    assert np.array_equal(camera.P, plain.P)


def test_first_cameras_stand_level_and_step_aside_by_20_degrees(mesh):
    photo = Photo("a.jpg", np.zeros((480, 640, 3), np.uint8))
    first = first_camera(mesh, photo, (0, 1, 0))
    second = first_camera(mesh, photo, (0, 1, 0), (first,))
    centre = mesh.bounds.mean(axis=0)
    a, b = (c.center - centre for c in (first, second))
    angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    assert angle == pytest.approx(20.0, abs=1e-6)
    assert abs(a[1]) < 1e-6 * np.linalg.norm(a)
    assert up_of((first, second)) == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)


def test_without_exif_a_first_camera_sees_50_degrees(mesh):
    photo = Photo("a.jpg", np.zeros((480, 640, 3), np.uint8))
    camera = first_camera(mesh, photo, (0, 1, 0))
    view = np.degrees(2 * np.arctan(320 / camera.focal_px))
    assert view == pytest.approx(50.0)


def test_keeping_the_size_keeps_f_over_distance_and_the_direction(camera):
    centre = np.array([0.2, 0.1, 0.0])
    longer = with_focal(camera, 2.0 * camera.focal_px, centre)
    before, after = camera.to_camera(centre[None])[0], longer.to_camera(centre[None])[0]
    assert after[2] == pytest.approx(2.0 * before[2])
    assert longer.K[1, 1] / longer.K[0, 0] == pytest.approx(640.0 / 700.0)
    x, y = longer.project(centre[None])[0] - camera.project(centre[None])[0]
    assert np.hypot(x, y) < 1e-9, "the object's centre moved in the photo"


@pytest.mark.parametrize("focal_px", [0.0, -5.0, np.nan, np.inf])
def test_a_focal_length_that_is_none_is_refused(camera, focal_px):
    with pytest.raises(InputError, match="focal length"):
        with_focal(camera, focal_px)


def test_roll_turns_about_the_principal_point_and_stays_in_place(camera):
    turned = rolled(camera, 90.0)
    assert turned.center == pytest.approx(camera.center)
    axis = camera.center + camera.R_cam_world[2] * 5.0
    assert turned.project(axis[None])[0] == pytest.approx(camera.K[:2, 2])


def test_a_nudge_moves_the_object_by_its_pixels_and_nothing_else(camera):
    centre = np.array([0.2, 0.1, 0.0])
    moved = nudged(camera, centre, 3.0, -2.0, 0.0)
    way = moved.project(centre[None])[0] - camera.project(centre[None])[0]
    assert way == pytest.approx((3.0, -2.0), abs=1e-9)
    assert np.array_equal(moved.R_cam_world, camera.R_cam_world)
    nearer = nudged(camera, centre, 0.0, 0.0, 0.1)
    before, after = camera.to_camera(centre[None])[0], nearer.to_camera(centre[None])[0]
    assert after == pytest.approx(0.9 * before), "nearer, at the same pixel"
    behind = camera.center - 5.0 * camera.R_cam_world[2]
    with pytest.raises(InputError, match="behind"):
        nudged(camera, behind, 1.0, 0.0, 0.0)


def test_poses_survive_the_way_to_the_page_and_back(mesh, camera):
    frame = DisplayFrame.of(mesh)
    corners = frame.to_page(mesh.bounds)
    assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(2.0)
    assert corners.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    rotation, position = frame.pose(camera)
    back = frame.with_pose(camera, rotation, position)
    assert back.center == pytest.approx(camera.center, abs=1e-6)
    assert back.R_cam_world == pytest.approx(camera.R_cam_world, abs=1e-15)


@pytest.mark.parametrize(("width", "height"), [(900, 500), (400, 700)])
def test_the_photo_behind_the_mesh_is_where_the_page_s_camera_sees_it(
    camera, width, height
):
    # A white dot at a photo pixel must come out where the ray of that pixel leaves
    # the canvas of a centred camera of the focal length chosen.
    focal = fitting_focal(camera, width, height)
    for x, y in ((60, 50), (590, 60), (320, 410)):
        pixels = np.zeros((480, 640, 3), np.uint8)
        pixels[y - 3 : y + 4, x - 3 : x + 4] = 255
        picture = warped_photo(pixels, camera, focal, width, height)
        bright = np.argwhere(picture[:, :, 0] > 128)
        centre = bright.mean(axis=0)[::-1]
        ray = np.linalg.inv(camera.K) @ (x, y, 1.0)
        expected = ray[:2] / ray[2] * focal + 0.5 * np.array([width - 1, height - 1])
        off = float(np.abs(centre - expected).max())
        assert off < 0.5, f"{off:.2f} px off"


def test_the_photo_behind_the_mesh_fits_into_the_canvas(camera):
    white = np.full((480, 640, 3), 255, np.uint8)
    for width, height in ((900, 500), (400, 700)):
        focal = fitting_focal(camera, width, height)
        picture = warped_photo(white, camera, focal, width, height)
        inside = picture.min(axis=2) > 250
        border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
        assert not border.any()


def test_a_file_that_is_neither_mesh_nor_photo_is_named(tmp_path):
    with pytest.raises(InputError, match=r"notes\.txt is neither"):
        open_files([tmp_path / "notes.txt"])


def test_a_folder_without_a_scene_is_refused(tmp_path):
    with pytest.raises(InputError, match="should hold a mesh"):
        open_folder(tmp_path)
