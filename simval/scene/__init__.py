"""Simulated trajectories: MuJoCo scenes, and proof that their data is true."""

from simval.scene.cache import simulate_cached
from simval.scene.catalogue import find_scene, scenes
from simval.scene.many import RestMeans, simulate_many
from simval.scene.models import model_path, models_folder
from simval.scene.rates import average_rates
from simval.scene.render import render, render_file
from simval.scene.run import simulate
from simval.scene.script import Scene, Script
from simval.scene.trajectory import Trajectory

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
