"""Environments that data come from and policies are tried in; simulators are extras and load when first used."""

from odaf.environments.maze import Maze
from odaf.environments.registry import make

__all__ = ["Maze", "make"]
