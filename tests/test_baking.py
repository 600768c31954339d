"""The textured model as the worker makes it for download and preview."""

import io
import zipfile
from typing import Any

import numpy as np
import pytest
import trimesh

from app.baking import Baker
from app.messages import Baked, Working
from app.warm_up import toy_scene


@pytest.fixture(scope="module")
def baked() -> Baked:
    *steps, model = Baker().bake(*toy_scene())
    fractions = [step.fraction for step in steps if isinstance(step, Working)]
    assert fractions == sorted(fractions)
    assert isinstance(model, Baked)
    return model


def test_the_preview_is_the_model_in_page_axes_with_texture(baked):
    loaded: Any = trimesh.load(
        io.BytesIO(baked.glb), file_type="glb", force="mesh", process=False
    )
    assert len(loaded.faces) == len(toy_scene()[0].faces)
    low, high = loaded.bounds
    assert np.linalg.norm(high - low) == pytest.approx(2.0, rel=1e-6)
    assert low + high == pytest.approx(np.zeros(3), abs=1e-6)
    uv = np.asarray(loaded.visual.uv)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    picture = np.asarray(loaded.visual.material.baseColorTexture)
    assert picture.std() > 10.0, "the texture should not be of one colour"


def test_the_archive_holds_obj_mtl_and_png_named_after_the_mesh(baked):
    with zipfile.ZipFile(io.BytesIO(baked.archive)) as archive:
        assert archive.testzip() is None
        assert sorted(archive.namelist()) == ["rock.mtl", "rock.obj", "rock.png"]


def test_the_model_remembers_the_cameras_it_was_made_with(baked):
    cameras = toy_scene()[2]
    assert all(
        np.array_equal(a.P, b.P) for a, b in zip(baked.cameras, cameras, strict=True)
    )
