"""Scenes with known truth."""

from photoreg.synthetic.options import SceneOptions as SceneOptions
from photoreg.synthetic.scene import Scene as Scene
from photoreg.synthetic.scene import demo_scene as demo_scene
from photoreg.synthetic.scene import make_scene as make_scene
from photoreg.synthetic.scene import write_scene as write_scene
