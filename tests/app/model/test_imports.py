"""What is on screen is values: the app's model loads nothing that computes a refinement."""

import subprocess
import sys

MAY_LOAD = {
    "checks",
    "errors",
    "limits",
    "names",
    "sources",
    "words",
    # What the scene is made of. A camera projects, so its compiled projection is there;
    # a mesh casts rays and a photo is made smaller, by Embree and OpenCV.
    "geometry.camera",
    "geometry.decimation",
    "geometry.lens",
    "geometry.mesh",
    "geometry.projection",
    "geometry.rotations",
    "imaging.colour",
    "imaging.encoding",
    "imaging.photo",
    # Settings, and what a run tells.
    "parameters.bounds",
    "parameters.freedom",
    "parameters.gene_box",
    "parameters.genes",
    "placing.outcome",
    "polish.config",
    "polish.disagreement",
    "registration.checkpoint",
    "registration.config",
    "registration.events",
    "registration.readiness",
    "registration.verdict",
    "report.cost_curve",
    "report.photo_comparison",
    "search.config",
    "search.genetic",
    "texture.config",
    # Files of a scene: a file of cameras, a texture's picture, a project's file.
    "formats.cameras.camera_set",
    "formats.cameras.cameras_json",
    "formats.cameras.lens_terms",
    "formats.mark",
    "formats.models.encode_texture",
    "formats.parsing",
    "formats.photos.registry",
    "formats.writing",
    "project.files",
    "project.folder",
}
"""Of the engine, by room. Whoever adds one asks first whether it is a value, and if it is,
whether it can stand in a module without compute."""

LOADED = """
import importlib, pkgutil, sys
import app.model
for module in pkgutil.iter_modules(app.model.__path__):
    importlib.import_module(f"app.model.{module.name}")
print(*(name for name, module in sys.modules.items()
        if name.startswith("photoreg.") and not hasattr(module, "__path__")))
"""


def test_the_model_loads_values_alone():
    run = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True
    )
    loaded = {name.removeprefix("photoreg.") for name in run.stdout.split()}
    assert "geometry.camera" in loaded
    assert sorted(loaded - MAY_LOAD) == []
    assert sorted(MAY_LOAD - loaded) == [], "no longer loaded: take it off the list"
