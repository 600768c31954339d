"""Kept searches: gone on from to the same answer, and never read where damaged."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photoreg.errors import InputError, PhotoregError
from photoreg.parameters.freedom import Freedom, Held
from photoreg.polish.config import PolishConfig
from photoreg.registration.checkpoint import Checkpoint, problem_digest
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished, Progress
from photoreg.registration.refinement import refine
from photoreg.search.genetic import GeneticConfig, evolve
from tests.scenes import small_scene

CONFIG = dataclasses.replace(
    RegistrationConfig.preset("default"),
    samples=150,
    genetic=GeneticConfig(population=24, generations=5, restarts=3),
    polish=PolishConfig(
        blurs_px=(4.0, 1.0), points=(800, 2000), rounds=(1, 1), iterations=3
    ),
)
SEARCH_ONLY = dataclasses.replace(CONFIG, polish_after=False)


def run(config=CONFIG, resume=None, freedom=None):
    scene = small_scene()
    return list(
        refine(scene.mesh, scene.photos, scene.rough_cameras, config, freedom, resume)
    )


def bits(cameras) -> bytes:
    return b"".join(
        part.tobytes() for c in cameras for part in (c.K, c.R_cam_world, c.t_cam_world)
    )


def checkpoint_of(event: Progress) -> Checkpoint:
    assert event.checkpoint is not None
    return event.checkpoint


def kept(event: Progress) -> Checkpoint:
    """The event's checkpoint, by way of its bytes."""
    return Checkpoint.from_bytes(checkpoint_of(event).to_bytes())


def end(*args, **kwargs) -> Finished:
    last = run(*args, **kwargs)[-1]
    assert isinstance(last, Finished)
    return last


def of_phase(events, phase) -> list[Progress]:
    return [e for e in events if isinstance(e, Progress) and e.phase == phase]


@pytest.mark.parametrize("config", [CONFIG, SEARCH_ONLY])
def test_a_search_goes_on_to_the_same_answer_bit_for_bit(config):
    events = run(config)
    whole = events[-1]
    assert isinstance(whole, Finished)
    search = of_phase(events, "search")
    assert len(search) == 3 * 6
    # The start of the search, the middle and both sides of the end of a restart, the end.
    for at in (0, 3, 5, 6, 13, 17):
        again = run(config, kept(search[at]))
        last = again[-1]
        assert isinstance(last, Finished)
        assert bits(last.cameras) == bits(whole.cameras), at
        assert (last.cost, last.reason) == (whole.cost, whole.reason), at
        assert (last.generations, last.evaluations) == (15, whole.evaluations)
        following = of_phase(again, "search")
        assert len(following) == len(search) - at - 1
        for event, once in zip(following, search[at + 1 :], strict=True):
            assert bits(event.cameras) == bits(once.cameras), at
            assert event.best_cost == once.best_cost
            assert event.fraction == once.fraction


def test_a_polish_begins_again_to_the_same_answer():
    events = run()
    assert isinstance(events[-1], Finished)
    polish = of_phase(events, "polish")
    for at in (0, len(polish) // 2, len(polish) - 1):
        checkpoint = kept(polish[at])
        assert checkpoint.phase == "polish"
        again = run(resume=checkpoint)
        assert isinstance(again[-1], Finished)
        assert not of_phase(again, "search")
        assert bits(again[-1].cameras) == bits(events[-1].cameras), at
        assert again[-1].expected_errors_px == events[-1].expected_errors_px


def test_a_search_that_stagnated_goes_on_to_the_same_answer():
    genetic = dataclasses.replace(CONFIG.genetic, stagnation=1, generations=9)
    config = dataclasses.replace(SEARCH_ONLY, genetic=genetic)
    events = run(config)
    assert isinstance(events[-1], Finished)
    for event in of_phase(events, "search")[::2]:
        again = end(config, kept(event))
        assert bits(again.cameras) == bits(events[-1].cameras)
        assert again.reason == events[-1].reason


def test_what_is_held_is_held_after_a_break_too():
    freedom = Freedom((Held(focal=True), Held(pose=True)))
    events = run(SEARCH_ONLY, freedom=freedom)
    event = of_phase(events, "search")[4]
    again = run(SEARCH_ONLY, kept(event), freedom)
    assert bits(again[-1].cameras) == bits(events[-1].cameras)


def test_a_cropped_photo_is_one_after_a_break_too_and_only_there():
    freedom = Freedom(cropped=(1,))
    events = run(SEARCH_ONLY, freedom=freedom)
    event = of_phase(events, "search")[4]
    again = run(SEARCH_ONLY, kept(event), freedom)
    assert bits(again[-1].cameras) == bits(events[-1].cameras)
    with pytest.raises(InputError, match="other photos, cameras or"):
        run(SEARCH_ONLY, kept(event))


def test_time_spent_before_the_break_counts():
    event = of_phase(run(SEARCH_ONLY), "search")[4]
    checkpoint = dataclasses.replace(checkpoint_of(event), elapsed_s=1000.0)
    again = run(SEARCH_ONLY, checkpoint)
    assert all(e.elapsed_s > 1000.0 for e in again if isinstance(e, Progress))


def test_a_checkpoint_survives_its_bytes():
    checkpoint = checkpoint_of(of_phase(run(SEARCH_ONLY), "search")[8])
    again = Checkpoint.from_bytes(checkpoint.to_bytes())
    assert again.to_bytes() == checkpoint.to_bytes()
    np.testing.assert_array_equal(again.search.genes, checkpoint.search.genes)
    np.testing.assert_array_equal(again.search.costs, checkpoint.search.costs)
    assert again.hidden_from is not None is not checkpoint.hidden_from
    np.testing.assert_array_equal(again.hidden_from, checkpoint.hidden_from)
    assert again.search.random_state == checkpoint.search.random_state
    assert again.problem == checkpoint.problem


def toy() -> Checkpoint:
    config = GeneticConfig(population=4, generations=2, restarts=1)
    *_, last = evolve(
        lambda g: np.where(g[:, 0] > 0, np.inf, (g**2).sum(axis=1)),
        lambda n, rng: rng.uniform(-1, 1, (n, 3)),
        config,
        0,
    )
    return Checkpoint("problem", "search", 2, 0.5, last)


@given(data=st.data())
@settings(max_examples=200, deadline=None)
def test_damage_of_any_kind_is_told_and_nothing_else_happens(data):
    good = toy().to_bytes()
    at = data.draw(st.integers(0, len(good) - 1))
    damaged = data.draw(
        st.one_of(
            st.just(good[:at]),
            st.binary(max_size=300),
            st.integers(1, 255).map(
                lambda flip: good[:at] + bytes([good[at] ^ flip]) + good[at + 1 :]
            ),
        )
    )
    with pytest.raises(InputError, match="start the refinement anew"):
        Checkpoint.from_bytes(damaged)


@pytest.mark.parametrize(
    "change",
    [
        {"genes": None},
        {"genes": {"shape": [2, 3], "float64": "AAAA"}},
        {"genes": {"shape": [10**9, 10**9], "float64": "AAAA"}},
        {"costs": {"shape": [1], "float64": "AAAAAAAA+H8="}},
        {"random_state": {"bit_generator": "MT19937"}},
        {"random_state": 3},
        {"phase": "supper"},
        {"stop": "hunger"},
        {"restart": "two"},
        {"evaluations": float("inf")},
    ],
)
def test_a_wrong_content_with_a_right_digest_is_refused_too(change):
    good = toy().to_bytes()
    head, _, text = good.partition(b"\n")
    body = json.dumps({**json.loads(text), **change}).encode()
    head = head[: head.rindex(b" ") + 1] + hashlib.sha256(body).hexdigest().encode()
    with pytest.raises(InputError, match="cannot be read"):
        Checkpoint.from_bytes(head + b"\n" + body)


def test_a_checkpoint_of_another_refinement_is_refused_at_once():
    scene = small_scene()
    checkpoint = checkpoint_of(of_phase(run(SEARCH_ONLY), "search")[2])
    for other in (
        dataclasses.replace(SEARCH_ONLY, seed=1),
        dataclasses.replace(SEARCH_ONLY, pull=2.0),
    ):
        with pytest.raises(InputError, match="another mesh, other photos, cameras"):
            refine(
                scene.mesh, scene.photos, scene.rough_cameras, other, None, checkpoint
            )
    with pytest.raises(InputError, match="another mesh, other photos, cameras"):
        refine(scene.mesh, scene.photos, scene.cameras, SEARCH_ONLY, None, checkpoint)


def test_a_population_of_another_size_is_refused():
    scene = small_scene()
    digest = problem_digest(
        scene.mesh, scene.photos, scene.rough_cameras, SEARCH_ONLY, Freedom()
    )
    forged = dataclasses.replace(toy(), problem=digest)
    with pytest.raises(PhotoregError, match="24 individuals of 18 genes, but has 4"):
        run(SEARCH_ONLY, forged)


def test_the_digest_tells_every_part_apart():
    scene = small_scene()
    base = (scene.mesh, scene.photos, scene.rough_cameras, CONFIG, Freedom())
    photo = scene.photos[0]
    darker = dataclasses.replace(photo, pixels=photo.pixels // 2)
    moved = dataclasses.replace(scene.mesh, vertices=scene.mesh.vertices + 1.0)
    fewer_patches = dataclasses.replace(
        CONFIG, polish=dataclasses.replace(CONFIG.polish, patches=10)
    )
    digests = {
        problem_digest(*base),
        problem_digest(moved, *base[1:]),
        problem_digest(base[0], [darker, scene.photos[1]], *base[2:]),
        problem_digest(*base[:2], scene.cameras, *base[3:]),
        problem_digest(*base[:3], SEARCH_ONLY, base[4]),
        problem_digest(*base[:4], Freedom((Held(focal=True), Held()))),
        problem_digest(
            *base[:3], dataclasses.replace(CONFIG, principal_point_prior=2.0), base[4]
        ),
        problem_digest(*base[:3], fewer_patches, base[4]),
    }
    assert len(digests) == 8
