"""The script that sets up cameras in Blender."""

from photoreg.formats.cameras.camera_set import CameraSet
from tests.formats.camera_files import NAMES, camera_set, write


def test_blender_s_script_is_python_whatever_the_names(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    name = 'a """ quote \\n.png'
    more = {**cameras.cameras, 'q\'""" x.png': cameras.cameras[NAMES[0]]}
    path, saved = write(tmp_path, "blender", CameraSet(more, cameras.photos))
    compile(path.read_text(encoding="utf-8"), str(path), "exec")
    assert saved.losses == []
    assert name not in more
