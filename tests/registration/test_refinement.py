"""The whole refinement: events, determinism, cancelling, ends and warnings."""

import dataclasses

import numba as nb
import numpy as np
import pytest

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.gene_box import GeneBox
from photoreg.parameters.genes import GeneMap
from photoreg.polish.config import PolishConfig
from photoreg.polish.misfit import disagreement
from photoreg.registration import refinement, verdict
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import border_warnings, refine
from photoreg.search.genetic import GeneticConfig
from tests.scenes import on_a_site, small_scene

pytestmark = pytest.mark.workqueue

SEARCH = dataclasses.replace(
    RegistrationConfig.preset("default"),
    samples=200,
    polish_after=False,
    genetic=GeneticConfig(population=40, generations=12, restarts=2),
)


def run(config=SEARCH, scene=None, cameras=None):
    scene = scene or small_scene()
    cameras = cameras or scene.rough_cameras
    return list(refine(scene.mesh, scene.photos, cameras, config))


def end(*args, **kwargs) -> Finished:
    last = run(*args, **kwargs)[-1]
    assert isinstance(last, Finished)
    return last


def same_cameras(first, second) -> bool:
    return all(np.array_equal(a.P, b.P) for a, b in zip(first, second, strict=True))


def turned_away(camera: Camera) -> Camera:
    turn = np.diag([-1.0, 1.0, -1.0])
    return Camera(
        camera.K,
        turn @ camera.R_cam_world,
        turn @ camera.t_cam_world,
        camera.width,
        camera.height,
    )


def test_the_default_preset_finds_the_cameras():
    scene = small_scene()
    *events, last = run(RegistrationConfig.preset("default"))
    assert isinstance(last, Finished)
    before = projection_error(scene.mesh, scene.cameras, scene.rough_cameras).mean
    after = projection_error(scene.mesh, scene.cameras, last.cameras).mean
    # 0.1 to 0.2 px were measured at this size of 320x240; the start is 6 px off.
    assert after < 0.5 < 4.0 < before, (before, after)
    phases = {event.phase for event in events if isinstance(event, Progress)}
    assert phases == {"prepare", "search", "polish"}
    # Each level of the polish tells it, and the last one of them to what is told at the end.
    told = {event.expected_error_px for event in events if isinstance(event, Progress)}
    # None is done twice: the lens that nothing shows was left before the finest. The last
    # of all is that of the correspondences.
    assert len(told) == 2 + len(RegistrationConfig().polish.blurs_px), told
    assert events[-1].expected_error_px == last.expected_error_px
    assert len(last.expected_errors_px) == len(last.standard_errors) == 2
    assert last.expected_error_px is not None
    assert after < 4.0 * last.expected_error_px < 4.0, (after, last.expected_error_px)
    for photo, sentence in zip(scene.photos, last.standard_errors, strict=True):
        assert sentence.startswith(f"{photo.name}: expected error ")
    # The mesh is exact, so what is told of it is the matches' own noise.
    assert last.mesh_error is not None
    assert last.mesh_error.sigma < 1e-3 * scene.mesh.diagonal


def test_a_detail_of_a_large_site_is_refined_as_by_itself():
    scene = small_scene()
    site = on_a_site(scene, 30.0)
    assert scene.mesh.area < 0.001 * site.area
    *_, last = refine(site, scene.photos, scene.rough_cameras)
    assert isinstance(last, Finished)
    after = projection_error(scene.mesh, scene.cameras, last.cameras).mean
    # As without the wall.
    assert after < 0.5, after
    assert last.verdict is not None
    assert last.verdict.grade == "convincing"


def end_elsewhere(scale: float, origin: np.ndarray) -> list[Camera]:
    """The small scene's end where it is enlarged and moved, put back."""
    scene, config = small_scene(), RegistrationConfig.preset("fast")
    rough = [
        dataclasses.replace(
            c, t_cam_world=scale * c.t_cam_world - c.R_cam_world @ origin
        )
        for c in scene.rough_cameras
    ]
    mesh = Mesh(scale * scene.mesh.vertices + origin, scene.mesh.faces)
    *_, last = refine(mesh, scene.photos, rough, config)
    return [
        dataclasses.replace(
            c, t_cam_world=(c.t_cam_world + c.R_cam_world @ origin) / scale
        )
        for c in last.cameras
    ]


@pytest.mark.slow
def test_units_and_a_national_grid_leave_the_whole_answer_as_it_is():
    at_origin = end_elsewhere(1.0, np.zeros(3))
    for scale, origin in (
        (1.0, np.array([512345.25, 5401234.5, 120.0])),
        (1e6, np.zeros(3)),
        (1e-6, np.zeros(3)),
    ):
        other = end_elsewhere(scale, origin)
        error = projection_error(small_scene().mesh, at_origin, other)
        assert error.max < 1e-3, (scale, error.max)


def test_a_search_that_misleads_is_not_followed():
    scene = small_scene()
    config = RegistrationConfig.preset("default")
    given = (scene.mesh, scene.photos, scene.rough_cameras, config, None)
    begun = next(
        event.checkpoint
        for event in refine(*given)
        if isinstance(event, Progress) and event.checkpoint is not None
    )
    # It ended in a corner of its box.
    corner = np.ones_like(begun.search.best_genes)
    misled = dataclasses.replace(begun.search, best_genes=corner, stop="generations")
    *events, last = refine(*given, dataclasses.replace(begun, search=misled))
    progress = [event for event in events if isinstance(event, Progress)]
    assert {event.phase for event in progress} == {"prepare", "polish"}
    assert isinstance(last, Finished)
    box = GeneMap(
        scene.rough_cameras, scene.mesh.centroid, config.box, "pinhole", "object"
    )
    lost = projection_error(scene.mesh, scene.cameras, box.to_cameras(corner)).mean
    after = projection_error(scene.mesh, scene.cameras, last.cameras).mean
    assert after < 0.5 < 15.0 < lost, (after, lost)


def test_a_doubtful_polish_is_tried_from_the_other_side_too(monkeypatch):
    scene = small_scene()
    starts = []
    original = refinement.polish_cameras

    def watched(mesh, photos, cameras, *rest):
        starts.append(cameras)
        return original(mesh, photos, cameras, *rest)

    monkeypatch.setattr(refinement, "polish_cameras", watched)
    monkeypatch.setattr(verdict, "COLOURS_AGREE", -1.0)
    monkeypatch.setattr(verdict, "OUTLINE_FITS", -1.0)
    quick = PolishConfig(blurs_px=(2.0,), points=(500,), rounds=(1,), iterations=2)
    last = end(dataclasses.replace(SEARCH, polish_after=True, polish=quick))
    assert len(starts) == 2
    assert any(same_cameras(start, scene.rough_cameras) for start in starts)
    costs = [
        disagreement(scene.mesh, scene.photos, start, quick.min_cosine).total
        for start in starts
    ]
    assert last.cost <= min(costs), (last.cost, costs)


def test_each_interval_of_the_prior_follows_its_own_of_the_box(monkeypatch):
    scales = []
    original = refinement.polish_cameras

    def watched(*args):
        for step in original(*args):
            scales.append(step.increments[0].scales)
            yield step

    monkeypatch.setattr(refinement, "polish_cameras", watched)
    quick = PolishConfig(blurs_px=(2.0,), points=(500,), rounds=(1,), iterations=1)
    usual = dataclasses.replace(SEARCH, polish_after=True, polish=quick)
    box = usual.box
    for changes, expected in (
        ({}, PriorScales()),
        ({"rotation_deg": 2.0 * box.rotation_deg}, PriorScales(rotation_deg=2.0)),
        (
            {"principal_point": 3.0 * box.principal_point},
            PriorScales(principal_point=0.015),
        ),
        ({"focal": 0.5 * box.focal}, PriorScales(focal=0.01)),
        ({"scale": 2.0 * box.scale}, PriorScales(translation=0.06)),
        ({"shift": 0.5 * box.shift}, PriorScales()),
    ):
        scales.clear()
        end(dataclasses.replace(usual, box=dataclasses.replace(box, **changes)))
        assert dataclasses.astuple(scales[0]) == pytest.approx(
            dataclasses.astuple(expected)
        ), changes


def test_the_papers_intervals_come_from_one_source():
    paper = RegistrationConfig.preset("paper")
    assert paper.prior_scales == PriorScales()
    for field in dataclasses.fields(PriorScales):
        assert getattr(GeneBox, field.name) is getattr(PriorScales, field.name)


def test_a_wide_box_widens_the_principal_points_prior_only_where_it_says_so():
    thorough = RegistrationConfig.preset("thorough")
    wide = [2.7 * one for one in dataclasses.astuple(PriorScales())]
    assert dataclasses.astuple(thorough.prior_scales) == pytest.approx(wide)
    plain = dataclasses.replace(thorough, principal_point_prior=1.0)
    assert plain.prior_scales == dataclasses.replace(
        thorough.prior_scales, principal_point=PriorScales().principal_point
    )


def test_the_last_event_is_finished_and_the_only_one():
    *events, last = run()
    assert isinstance(last, Finished)
    assert all(isinstance(event, Progress) for event in events)
    assert set(last.seconds_by_phase) == {"prepare", "search"}
    assert last.expected_error_px is None  # Without a polish nothing is known.


def test_progress_never_goes_back():
    events = [event for event in run() if isinstance(event, Progress)]
    for name in ("fraction", "generation", "evaluations", "elapsed_s"):
        values = [getattr(event, name) for event in events]
        assert (np.diff(values) >= 0).all(), name
    assert 0.0 <= events[0].fraction <= events[-1].fraction <= 1.0
    assert events[-1].step == "generation 24 of 24"


def test_the_best_cost_of_a_restart_never_rises():
    events = [event for event in run() if isinstance(event, Progress)]
    first = [e.best_cost for e in events if e.evaluations > 0 and e.generation <= 12]
    assert (np.diff(first) <= 0).all()


def test_progress_tells_what_a_live_display_shows():
    quick = PolishConfig(blurs_px=(2.0, 1.0), points=(500, 500), rounds=(2, 1))
    config = dataclasses.replace(SEARCH, polish_after=True, polish=quick)
    *events, last = run(config)
    events = [event for event in events if isinstance(event, Progress)]
    assert isinstance(last, Finished)
    search = [e for e in events if e.phase == "search"]
    for event in search:
        assert event.quartile_costs is not None
        assert event.population is not None
        assert event.checkpoint is not None
        low, high = event.quartile_costs
        assert event.best_cost <= low <= event.median_cost <= high
        population = event.population
        assert len(population.genes) == len(population.costs) == 40
        cloud = population.centers(10)
        assert cloud.shape == (10, 2, 3)
        assert event.checkpoint.search.evaluations == event.evaluations
    # The best individual leads the cloud, and at last it is the best of all.
    centers = [camera.center for camera in search[-1].cameras]
    assert search[-1].population is not None
    np.testing.assert_allclose(search[-1].population.centers(1)[0], centers, rtol=1e-9)
    marks = [event.begins for event in events if event.begins is not None]
    assert marks == [
        "restart 1 of 2",
        "restart 2 of 2",
        "polish, level 1 of 3",
        "polish, level 2 of 3",
        "polish, level 3 of 3",
    ]
    polish = [e for e in events if e.phase == "polish"]
    assert all(e.population is None is e.quartile_costs for e in polish)
    # A level tells at its end how far off the answer is to be expected.
    begins = [e.begins for e in polish].index("polish, level 2 of 3")
    assert all(e.expected_error_px is None for e in [*search, *polish[: begins - 1]])
    assert all(e.expected_error_px is not None for e in polish[begins - 1 :])
    assert last.expected_error_px is not None
    assert events[-1].expected_error_px == last.expected_error_px > 0.0


def test_every_event_holds_a_whole_answer():
    scene = small_scene()
    for event in run():
        sizes = [(camera.width, camera.height) for camera in event.cameras]
        assert sizes == [(photo.width, photo.height) for photo in scene.photos]


def test_a_refinement_is_a_function_of_its_seed():
    first, same = end(), end()
    other = end(dataclasses.replace(SEARCH, seed=1))
    assert same_cameras(first.cameras, same.cameras)
    assert not same_cameras(first.cameras, other.cameras)


def test_the_number_of_threads_changes_nothing():
    n_threads = nb.get_num_threads()
    answers = []
    try:
        for n in (1, n_threads):
            nb.set_num_threads(n)
            answers.append(end().cameras)
    finally:
        nb.set_num_threads(n_threads)
    assert same_cameras(*answers)


@pytest.mark.parametrize("n_events", [1, 2, 5])
def test_to_stop_iterating_is_to_cancel(n_events):
    scene = small_scene()
    events = refine(scene.mesh, scene.photos, scene.rough_cameras, SEARCH)
    taken = [next(events) for _ in range(n_events)]
    events.close()
    assert len(taken[-1].cameras) == 2
    assert list(events) == []


def test_the_answer_never_costs_more_than_the_start():
    scene = small_scene()
    for cameras in (scene.rough_cameras, scene.cameras):
        last = end(cameras=cameras)
        assert last.cost <= last.start_cost, (last.cost, last.start_cost)


def test_cost_level_ends_the_search_and_says_so():
    genetic = dataclasses.replace(SEARCH.genetic, stop_cost=1e9)
    last = end(dataclasses.replace(SEARCH, genetic=genetic))
    assert last.generations == 0
    assert last.reason.startswith("The cost fell to the level that was set")


def test_stagnation_ends_the_search_and_says_so():
    genetic = dataclasses.replace(SEARCH.genetic, stagnation=1, mutation_rate=0.0)
    last = end(dataclasses.replace(SEARCH, genetic=genetic))
    assert last.generations < 24
    assert last.reason == "The search stopped improving."


@pytest.mark.parametrize("model", ["pinhole", "full"])
@pytest.mark.parametrize("cost", ["ssd", "mncc"])
@pytest.mark.parametrize("occlusion", ["normals", "depth"])
def test_the_papers_variants_can_be_chosen_by_name(model, cost, occlusion):
    paper = RegistrationConfig.preset("paper")
    config = dataclasses.replace(
        paper,
        camera_model=model,
        occlusion=occlusion,
        consistency=dataclasses.replace(paper.consistency, cost=cost, colour="hsi"),
        genetic=GeneticConfig(population=20, generations=3, restarts=1),
    )
    last = end(config)
    assert last.cost < last.start_cost


def test_the_paper_preset_is_the_papers():
    paper = RegistrationConfig.preset("paper", seed=3)
    assert (paper.seed, paper.samples, paper.camera_model) == (3, 1000, "pinhole")
    assert (paper.occlusion, paper.polish_after, paper.pull) == ("normals", False, 0.0)
    consistency, genetic, box = paper.consistency, paper.genetic, paper.box
    assert (consistency.colour, consistency.cost) == ("luv", "alpha_trimmed")
    assert (consistency.alpha, consistency.min_cosine) == (0.2, 0.5)
    assert not consistency.exposure
    assert not consistency.relative
    assert consistency.blur_px == 0.0
    assert (genetic.population, genetic.generations, genetic.restarts) == (500, 100, 5)
    # The tournament and the mutations are those of GAlib, which the paper used.
    assert genetic.replacement == "steady_state"
    assert (genetic.selection, genetic.tournament_size) == ("wheel_tournament", 2)
    assert genetic.mutations == "fixed_number"
    assert (genetic.replaced_share, genetic.crossover_rate) == (0.25, 0.9)
    assert (genetic.crossover, genetic.mutation_rate) == ("uniform", 0.1)
    assert (box.focal, box.principal_point) == (0.02, 0.005)
    assert (box.translation, box.rotation_deg) == (0.03, 1.0)


def test_several_photos_register_together():
    scene = small_scene(n_photos=4)
    last = end(scene=scene)
    assert len(last.cameras) == 4
    assert last.cost < 0.8 * last.start_cost, (last.cost, last.start_cost)


def test_a_camera_that_sees_nothing_is_left_and_named():
    scene = small_scene(n_photos=3)
    cameras = [*scene.rough_cameras[:2], turned_away(scene.rough_cameras[2])]
    last = end(scene=scene, cameras=cameras)
    assert last.cameras[2] is cameras[2]
    assert not same_cameras(last.cameras[:2], cameras[:2])
    assert any(scene.photos[2].name in warning for warning in last.warnings)


def test_no_camera_that_sees_anything_is_an_error():
    scene = small_scene()
    away = [turned_away(camera) for camera in scene.rough_cameras]
    with pytest.raises(RefinementError, match="No camera sees the surface"):
        run(cameras=away)


def test_photos_of_opposite_sides_cannot_be_compared():
    scene = small_scene()
    one = scene.rough_cameras[0]
    flip = np.diag([-1.0, 1.0, -1.0])
    middle = one.to_camera(scene.mesh.centroid[None])[0]
    # The same view from behind: turned about the centroid by half a turn.
    R = flip @ one.R_cam_world
    behind = Camera(one.K, R, middle - R @ scene.mesh.centroid, one.width, one.height)
    with pytest.raises(RefinementError, match="hardly any common part"):
        run(cameras=[one, behind])


def test_an_answer_on_the_border_of_the_box_is_told():
    box = dataclasses.replace(SEARCH.box, scale=1e-4, shift=1e-4)
    genetic = dataclasses.replace(SEARCH.genetic, mutation_sigma=0.6)
    last = end(dataclasses.replace(SEARCH, box=box, pull=0.0, genetic=genetic))
    assert any("border of the search box" in warning for warning in last.warnings)


def test_the_genes_on_the_border_are_told_camera_by_camera():
    scene = small_scene()
    genes = GeneMap(scene.rough_cameras, scene.mesh.centroid)
    names = ["left.png", "right.png"]
    far, warnings = border_warnings(genes, scene.rough_cameras, 0.0, names)
    assert far == names
    (warning,) = warnings
    assert "(camera 1: focal length, principal point x, " in warning
    assert " and centre z; camera 2: focal length, " in warning
    assert border_warnings(genes, scene.rough_cameras, 0.1, names) == ([], [])


def test_a_missing_camera_is_refused_at_once():
    scene = small_scene()
    with pytest.raises(InputError, match="2 photos but 1 cameras"):
        refine(scene.mesh, scene.photos, scene.rough_cameras[:1])


def test_a_camera_of_another_size_is_refused_at_once():
    scene = small_scene()
    cameras = [scene.rough_cameras[0], scene.rough_cameras[1].resized(640, 480)]
    with pytest.raises(InputError, match="320x240 px, but its camera is for 640x480"):
        refine(scene.mesh, scene.photos, cameras)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", -1),
        ("samples", 3),
        ("pull", -1),
        ("principal_point_prior", 0),
        ("principal_point_prior", np.nan),
    ],
)
def test_an_impossible_setting_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} is {value}; give"):
        dataclasses.replace(SEARCH, **{name: value})


def test_an_answer_that_does_not_convince_and_is_no_better_gives_the_start_back():
    scene = small_scene()
    rng = np.random.default_rng(3)
    photos = [
        dataclasses.replace(
            photo, pixels=rng.integers(0, 256, photo.pixels.shape, dtype=np.uint8)
        )
        for photo in scene.photos
    ]
    quick = PolishConfig(blurs_px=(4.0, 1.0), points=(500, 1000), rounds=(1, 1))
    config = dataclasses.replace(SEARCH, polish_after=True, polish=quick)
    *_, last = refine(scene.mesh, photos, scene.rough_cameras, config)
    assert isinstance(last, Finished)
    assert same_cameras(last.cameras, scene.rough_cameras)
    assert last.cost == last.start_cost
    assert last.verdict is not None
    assert not last.verdict.is_credible
    assert "start" in last.reason
    assert last.expected_error_px is None
