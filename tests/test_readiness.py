"""What is said of a refinement before it starts, on made scenes."""

import dataclasses

import numpy as np

from photoreg.camera import Camera
from photoreg.readiness import check_readiness
from photoreg.synthetic import Scene, SceneOptions, make_scene


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
