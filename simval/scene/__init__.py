"""Simulated motions: MuJoCo scenes, with checks that their data is consistent."""

from simval.scene.cache import simulate_cached
from simval.scene.catalogue import find_scene, scenes
from simval.scene.physics import model_path, models_folder
from simval.scene.pictures import render, render_file
from simval.scene.run import RestMeans, simulate, simulate_many
from simval.scene.script import Scene, Script
from simval.scene.trajectory import Trajectory, average_rates

__all__ = [
    "RestMeans",
    "Scene",
    "Script",
    "Trajectory",
    "average_rates",
    "find_scene",
    "model_path",
    "models_folder",
    "render",
    "render_file",
    "scenes",
    "simulate",
    "simulate_cached",
    "simulate_many",
]
