"""A Blender script that sets up the cameras, each with its photo behind the view.

Blender's cameras look along -z with y up. Lens and shift are shares of the sensor,
which is laid along the photo's width. One picture size and one pixel aspect rule a
whole Blender scene, so photos of another size or aspect get a scene of their own.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from photoreg.formats.cameras.camera_set import OPENGL_AXES, CameraSet, Saved, without
from photoreg.formats.photos.files import path_from
from photoreg.formats.writing import write_files
from photoreg.geometry.camera import Camera

SENSOR_MM = 36.0

_SCRIPT = '''# made by photoreg
"""Cameras with their photos behind them.

Open this in Blender's text editor and run it, or name it after blender --python.
"""

import json
from pathlib import Path

import bpy
from mathutils import Matrix

CAMERAS = json.loads(r"""
{cameras}
""")


def folder():
    """Where this script lies, in the text editor and on the command line."""
    text = getattr(getattr(bpy.context, "space_data", None), "text", None)
    return Path(bpy.path.abspath(text.filepath) if text else __file__).parent


def scene_for(entry):
    """The scene with the camera's picture size and pixel aspect."""
    size = (entry["width"], entry["height"], *entry["pixel_aspect"])
    for scene in bpy.data.scenes:
        if tuple(scene.get("photoreg_size", ())) == size:
            return scene
    first = bpy.context.scene
    if "photoreg_size" in first:
        scene = bpy.data.scenes.new(entry["photo"])
        for thing in first.collection.objects:
            scene.collection.objects.link(thing)
        for collection in first.collection.children:
            scene.collection.children.link(collection)
    else:
        scene = first
    scene["photoreg_size"] = size
    scene.render.resolution_x, scene.render.resolution_y = size[:2]
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = size[2:]
    return scene


def add_camera(entry):
    """One camera, with its photo behind what it sees."""
    scene = scene_for(entry)
    lens = bpy.data.cameras.new(entry["photo"])
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = {sensor}
    lens.lens = entry["lens"]
    lens.shift_x, lens.shift_y = entry["shift"]
    lens.clip_start, lens.clip_end = entry["clip"]
    camera = bpy.data.objects.new(entry["photo"], lens)
    camera.matrix_world = Matrix(entry["matrix_world"])
    scene.collection.objects.link(camera)
    if scene.camera is None or "photoreg_size" not in scene.camera:
        scene.camera = camera
    camera["photoreg_size"] = (entry["width"], entry["height"])
    path = folder() / entry["path"]
    if path.is_file():
        background = lens.background_images.new()
        background.image = bpy.data.images.load(str(path), check_existing=True)
        background.alpha = 0.5
        background.frame_method = "STRETCH"
        background.display_depth = "FRONT"
        lens.show_background_images = True
    else:
        print("The photo is not there:", path)
    return camera


for entry in CAMERAS:
    add_camera(entry)
'''


def save_blender(path: Path, cameras: CameraSet, overwrite: bool = False) -> Saved:
    """Writes the script; photos are looked for where they lie, from the script's folder.

    Raises:
        OutputError: if it cannot be written there.
    """
    entries, losses = [], []
    for name, camera in cameras.cameras.items():
        camera, lost = without(name, camera, "Blender", "skew", lens_terms=())
        losses += lost
        photo = cameras.photos.get(name)
        where = path_from(path.parent, photo) if photo else name
        entries.append(_entry(name, where, camera))
    # A JSON text in a raw string: a quote or backslash in a name must not end it.
    text = json.dumps(entries, indent=1).replace('"""', '\\u0022""')
    script = _SCRIPT.replace("{sensor}", repr(SENSOR_MM))
    contents = {path: script.replace("{cameras}", text)}
    return Saved(write_files(contents, cameras.files, overwrite), losses)


def _entry(name: str, where: str, camera: Camera) -> dict[str, Any]:
    (fx, _, cx), (_, fy, cy) = camera.K[:2].tolist()
    width, height = camera.width, camera.height
    # Blender's pixels are at least 1 wide and high; fx / fy is their height by width.
    pixel_aspect = [1.0, fx / fy] if fx >= fy else [fy / fx, 1.0]
    pose = np.eye(4)
    pose[:3, :3] = camera.R_cam_world.T @ OPENGL_AXES
    pose[:3, 3] = camera.center
    # The object's distance is not known here; its order is that of the coordinates.
    reach = max(float(np.linalg.norm(camera.center)), 1e-6)
    return {
        "photo": name,
        "path": where,
        "width": width,
        "height": height,
        "pixel_aspect": pixel_aspect,
        "lens": fx / width * SENSOR_MM,
        "shift": [
            0.5 - (cx + 0.5) / width,
            fx / fy * ((cy + 0.5) - 0.5 * height) / width,
        ],
        "clip": [1e-3 * reach, 1e3 * reach],
        "matrix_world": pose.tolist(),
    }
