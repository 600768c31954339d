"""What a gene box means in pixels."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.projection_error import projection_error
from photoreg.parameters.freedom import Freedom, Held
from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap
from photoreg.registration.config import OBJECT_BOX
from photoreg.search.box_reach import box_reach
from tests.scenes import small_scene


def test_the_reach_is_the_projection_error_of_draws_from_the_box():
    scene = small_scene()
    reach = box_reach(scene.mesh, scene.rough_cameras, OBJECT_BOX)
    genes = GeneMap(
        scene.rough_cameras, scene.mesh.centroid, OBJECT_BOX, coordinates="object"
    )
    draws = genes.first_population(60, np.random.default_rng(5))
    errors = [
        projection_error(
            scene.mesh, scene.rough_cameras, genes.to_cameras(draw), 1000
        ).mean
        for draw in draws
    ]
    # 60 draws tell a median to a tenth.
    assert np.isclose(reach.typical_px, np.median(errors), rtol=0.15), reach
    assert reach.typical_px < reach.farthest_px < 1.3 * max(errors), reach


def test_a_shift_moves_by_its_interval():
    scene = small_scene()
    reach = box_reach(scene.mesh, scene.rough_cameras, OBJECT_BOX)
    by_name = dict(reach.by_gene)
    # The centroid moves by 5 % of 320 px; what is seen is nearer, and moves further.
    for axis in "xy":
        moved = by_name[f"camera 1: place in the photo {axis}"]
        assert 16.0 < moved < 20.0, moved


@pytest.mark.parametrize("coordinates", ["camera", "object"])
def test_twice_the_box_reaches_twice_as_far(coordinates):
    scene = small_scene()
    small = GeneBox(
        **{name: 0.2 * v for name, v in dataclasses.asdict(OBJECT_BOX).items()}
    )
    args = (scene.mesh, scene.rough_cameras)
    one = box_reach(*args, small, coordinates=coordinates)
    two = box_reach(*args, small.widened(2.0), coordinates=coordinates)
    assert np.isclose(two.typical_px / one.typical_px, 2.0, rtol=0.1)


def test_the_reach_has_no_units():
    scene = small_scene()
    large = dataclasses.replace(scene.mesh, vertices=1e3 * scene.mesh.vertices)
    cameras = [
        dataclasses.replace(camera, t_cam_world=1e3 * camera.t_cam_world)
        for camera in scene.rough_cameras
    ]
    one = box_reach(scene.mesh, scene.rough_cameras, OBJECT_BOX)
    other = box_reach(large, cameras, OBJECT_BOX)
    assert np.isclose(one.typical_px, other.typical_px, rtol=1e-6)


def test_what_is_held_reaches_nowhere():
    scene = small_scene()
    held = Freedom((Held(focal=True, principal_point=True, pose=True), Held()))
    part = box_reach(scene.mesh, scene.rough_cameras, OBJECT_BOX, freedom=held)
    whole = box_reach(scene.mesh, scene.rough_cameras, OBJECT_BOX)
    assert np.isclose(part.typical_px, 0.5 * whole.typical_px, rtol=0.15)
    assert all(name.startswith("camera 2") for name, _ in part.by_gene)


def test_cameras_that_see_nothing_are_told():
    scene = small_scene()
    turn = np.diag([-1.0, 1.0, -1.0])
    away = [
        dataclasses.replace(
            c, R_cam_world=turn @ c.R_cam_world, t_cam_world=turn @ c.t_cam_world
        )
        for c in scene.rough_cameras
    ]
    with pytest.raises(InputError, match="No camera sees the surface"):
        box_reach(scene.mesh, away, OBJECT_BOX)
