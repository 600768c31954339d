"""Run by Blender's Python: sets up cameras by our script and projects points.

Usage: blender_reads.py SCRIPT POINTS.json MODEL.glb MODEL.obj OUT.json
"""

import importlib
import json
import runpy
import sys
from pathlib import Path

bpy = importlib.import_module("bpy")
bpy.ops.wm.read_factory_settings(use_empty=True)
script, points, glb, obj, out = map(Path, sys.argv[1:])
runpy.run_path(str(script), run_name="__main__")
found = {"cameras": {}}
for name, world in json.loads(points.read_text(encoding="utf-8")).items():
    camera = bpy.data.objects[name]
    (scene,) = (
        s
        for s in bpy.data.scenes
        if tuple(s["photoreg_size"][:2]) == tuple(camera["photoreg_size"])
    )
    render = scene.render
    width, height = render.resolution_x, render.resolution_y
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        depsgraph = bpy.context.evaluated_depsgraph_get()
    projection = camera.calc_matrix_camera(
        depsgraph,
        x=width,
        y=height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    view = camera.matrix_basis.inverted()
    pixels = []
    for point in world:
        clip = projection @ (
            view @ importlib.import_module("mathutils").Vector([*point, 1.0])
        )
        x, y = clip[0] / clip[3], clip[1] / clip[3]
        pixels.append([0.5 * (1.0 + x) * width - 0.5, 0.5 * (1.0 - y) * height - 0.5])
    background = camera.data.background_images[0].image
    found["cameras"][name] = {"pixels": pixels, "photo": list(background.size)}
for kind, path, load in (
    ("glb", glb, bpy.ops.import_scene.gltf),
    ("obj", obj, bpy.ops.wm.obj_import),
):
    known = set(bpy.data.images)
    bpy.ops.object.select_all(action="DESELECT")
    load(filepath=str(path))
    (mesh,) = (o for o in bpy.context.selected_objects if o.type == "MESH")
    (image,) = (i for i in bpy.data.images if i not in known and i.size[0])
    found[kind] = {
        "vertices": [list(mesh.matrix_world @ v.co) for v in mesh.data.vertices],
        "n_faces": len(mesh.data.polygons),
        "uv": [list(loop.uv) for loop in mesh.data.uv_layers[0].data],
        "texture": list(image.size),
    }
out.write_text(json.dumps(found), encoding="utf-8")
