"""One picture of the robot in its standing pose, drawn in the background.

Run as `python -m asimov_gym.cli.frame FILE.png`, with `MUJOCO_GL` set to a headless backend (see
`asimov_gym.rendering.backends`).
"""

from __future__ import annotations

import sys
from pathlib import Path


def render(path: Path, width: int = 720, height: int = 960) -> None:
    """Draw the standing robot from its front left into a PNG file of `width` × `height` pixels."""
    import imageio.v3 as imageio
    import mujoco

    from asimov_gym.assets import asset_path

    model = mujoco.MjModel.from_xml_path(str(asset_path("asimov1.xml")))
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.shadowsize = 8192
    model.vis.quality.offsamples = 8
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.keyframe("stand").id)
    mujoco.mj_forward(model, data)

    camera = mujoco.MjvCamera()
    # The pelvis is 0.61 m up and the head 1.2 m: look at the middle of the machine.
    camera.lookat = (0.0, 0.0, 0.62)
    camera.distance = 1.95
    camera.azimuth = 215.0
    camera.elevation = -10.0
    path.parent.mkdir(parents=True, exist_ok=True)
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        imageio.imwrite(path, renderer.render())


if __name__ == "__main__":
    render(Path(sys.argv[1]))
