"""Draws ``docs/terrain.png``: the robot at the start of every terrain.

Usage: ``python docs/terrain_picture.py``. Needs a working OpenGL; ``asimov doctor`` says which.
"""

from __future__ import annotations

import os
from pathlib import Path

from asimov_gym.rendering.backends import headless_backend

if "MUJOCO_GL" not in os.environ and (_backend := headless_backend()) is not None:
    os.environ["MUJOCO_GL"] = _backend  # before MuJoCo is imported

import imageio.v3 as imageio
import mujoco
import numpy as np

from asimov_gym.rendering.offscreen import FILM, OffscreenRenderer
from asimov_gym.robot.model import robot_model
from asimov_gym.robot.terrain import TERRAINS, Terrain

PICTURE = Path(__file__).resolve().with_name("terrain.png")
WIDTH, HEIGHT, COLUMNS = 560, 300, 2


def view(terrain: Terrain) -> np.ndarray:
    """The robot at the origin and what lies ahead of it, (HEIGHT, WIDTH, 3) uint8."""
    model = robot_model(terrain=terrain)
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = (2.3, 0.0, 0.25), 5.2, 52.0, -16.0
    renderer = OffscreenRenderer(model, WIDTH, HEIGHT, FILM)
    picture = renderer.draw(model.key("stand").qpos, camera)
    renderer.close()
    return picture


def main() -> None:
    pictures = [view(terrain) for terrain in TERRAINS.values()]
    rows = [np.concatenate(pictures[k : k + COLUMNS], axis=1) for k in range(0, len(pictures), COLUMNS)]
    imageio.imwrite(PICTURE, np.concatenate(rows))
    print(f"{PICTURE.name}, row by row: {', '.join(TERRAINS)}")


if __name__ == "__main__":
    main()
