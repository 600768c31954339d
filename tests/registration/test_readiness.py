"""What is said of a refinement before it starts, on made scenes."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.surface_view import surface_view
from photoreg.imaging.photo import Photo
from photoreg.registration.check_readiness import check_readiness
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene


def rock(**options) -> Scene:
    return make_scene(
        SceneOptions(
            kind="mid", light="flat", width=320, height=240, n_faces=1_280, **options
        )
    )


def aside(camera: Camera) -> Camera:
    """The camera moved so far aside that it sees nothing of the object."""
    far = camera.t_cam_world + np.array([100.0 * camera.t_cam_world[2], 0.0, 0.0])
    return dataclasses.replace(camera, t_cam_world=far)


def test_a_faint_texture_under_noise_is_enough_and_noise_alone_is_not():
    faint = rock()
    assert check_readiness(faint.mesh, faint.photos, faint.rough_cameras).plain == ()
    bare = rock(contrast=0.0)
    found = check_readiness(bare.mesh, bare.photos, bare.rough_cameras)
    assert found.plain == tuple(photo.name for photo in bare.photos)
    assert found.is_possible
    assert [problem.partition(" ")[0] for problem in found.problems] == [*found.plain]


def test_a_camera_that_looks_past_the_object_is_named():
    scene = rock()
    cameras = (scene.cameras[0], aside(scene.cameras[1]))
    found = check_readiness(scene.mesh, scene.photos, cameras)
    assert found.blind == (scene.photos[1].name,)
    assert found.overlap == 0.0
    assert not found.is_possible
    assert scene.photos[1].name in found.problems[0]


def filled(photo: Photo, value: int) -> Photo:
    return dataclasses.replace(photo, pixels=np.full_like(photo.pixels, value))


@pytest.mark.parametrize("value", [0, 255])
def test_photos_of_one_colour_are_refused_before_the_run(value):
    scene = rock()
    photos = [filled(scene.photos[0], value), scene.photos[1]]
    found = check_readiness(scene.mesh, photos, scene.rough_cameras)
    assert found.featureless == (photos[0].name,)
    assert not found.is_possible
    assert found.problems == found.refusals
    with pytest.raises(InputError, match=f"{photos[0].name} shows neither texture"):
        list(refine(scene.mesh, photos, scene.rough_cameras))


def test_a_camera_far_off_over_bare_background_is_no_fault_of_its_photo():
    scene = rock()
    # The object is small in the photo's corner; the camera looks for it in the middle.
    photo = scene.photos[0]
    pixels = np.full_like(photo.pixels, 90)
    pixels[:48, :64] = photo.pixels[::5, ::5]
    photos = [dataclasses.replace(photo, pixels=pixels), scene.photos[1]]
    found = check_readiness(scene.mesh, photos, scene.cameras)
    assert photo.name in found.plain
    assert found.featureless == ()
    assert found.is_possible


def test_one_picture_under_two_names_is_refused_before_the_run():
    scene = rock()
    first = scene.photos[0]
    photos = [first, dataclasses.replace(first, name="again.png")]
    found = check_readiness(scene.mesh, photos, scene.rough_cameras)
    assert found.same == ((first.name, "again.png"),)
    assert not found.is_possible
    with pytest.raises(InputError, match="are the same picture"):
        list(refine(scene.mesh, photos, scene.rough_cameras))


def test_a_mask_over_the_whole_object_is_refused_before_the_run():
    scene = rock()
    covered = surface_view(scene.mesh, scene.rough_cameras[1]).covered
    photos = [scene.photos[0], dataclasses.replace(scene.photos[1], mask=~covered)]
    found = check_readiness(scene.mesh, photos, scene.rough_cameras)
    assert found.masked == (photos[1].name,)
    assert not found.is_possible
    with pytest.raises(InputError, match=f"mask of {photos[1].name} leaves hardly"):
        list(refine(scene.mesh, photos, scene.rough_cameras))


def test_a_mask_that_leaves_the_object_is_no_obstacle():
    scene = rock()
    covered = surface_view(scene.mesh, scene.cameras[1]).covered
    photos = [scene.photos[0], dataclasses.replace(scene.photos[1], mask=covered)]
    found = check_readiness(scene.mesh, photos, scene.rough_cameras)
    assert found.is_possible
    assert found.problems == ()
