"""The ant of D4RL's mazes for MuJoCo: gymnasium's own, changed in three places, and walls around it.

Source: `ant.xml` of D4RL (Fu et al. 2020) beside gymnasium's. All else that moves is the same in both.
"""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium.envs.mujoco
import mujoco

from odaf.environments.ant_maze_map import CELL, AntMazeMap
from odaf.errors import ConfigError

TORQUE = 30.0  # largest torque of a motor; gymnasium's ant has 150
WALL_HEIGHT = 0.5 * CELL

_TIMESTEP = "0.02"  # seconds; gymnasium's ant has 0.01
_CONTACT = {"solref": ".02 1", "solimp": ".8 .8 .01"}  # gymnasium's ant has MuJoCo's own: .02 1 and .9 .95 .001
_WALL = {"type": "box", "contype": "1", "conaffinity": "1", "rgba": "0.7 0.5 0.3 1"}


def ant_model(maze: AntMazeMap | None) -> Any:
    """A fresh `mujoco.MjModel` of the ant at the origin, and a box named `block_ROW_COLUMN` for each wall.

    Args:
        maze: where the walls stand; None is an open plane without end.

    Raises:
        ConfigError: the installed gymnasium's ant is built in another way than those we know.
    """
    root = ElementTree.fromstring((Path(gymnasium.envs.mujoco.__file__).parent / "assets" / "ant.xml").read_bytes())
    _one(root, "option").set("timestep", _TIMESTEP)
    _one(root, "default/geom").attrib.update(_CONTACT)
    for motor in root.iterfind("actuator/motor"):
        motor.attrib.update(ctrlrange=f"{-TORQUE} {TORQUE}", gear="1")
    world = _one(root, "worldbody")
    half = f"{CELL / 2} {CELL / 2} {WALL_HEIGHT / 2}"
    for cell, (x, y) in () if maze is None else ((cell, maze.centre(cell)) for cell in maze.walls):
        place = {"name": f"block_{cell[0]}_{cell[1]}", "pos": f"{x} {y} {WALL_HEIGHT / 2}", "size": half}
        ElementTree.SubElement(world, "geom", place | _WALL)
    # The compiled module comes without stubs.
    return getattr(mujoco, "MjModel").from_xml_string(ElementTree.tostring(root, encoding="unicode"))  # noqa: B009


def _one(root: ElementTree.Element, path: str) -> ElementTree.Element:
    found = root.find(path)
    if found is None:
        raise ConfigError(f"ant maze: gymnasium's ant.xml has no <{path}>; the one of gymnasium 1.2 to 1.4 has")
    return found
