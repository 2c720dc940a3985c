"""Simulated recordings: MuJoCo scenes, and proof that their data is true."""

from simval.scene.cache import recorded
from simval.scene.catalogue import find_scene, scenes
from simval.scene.many import RestMeans, record_many
from simval.scene.models import model_path, models_folder
from simval.scene.recording import Recording
from simval.scene.render import render, render_file
from simval.scene.run import record
from simval.scene.script import Scene, Script

__all__ = [
    "Recording",
    "RestMeans",
    "Scene",
    "Script",
    "find_scene",
    "model_path",
    "models_folder",
    "record",
    "record_many",
    "recorded",
    "render",
    "render_file",
    "scenes",
]
