"""`asimov view`: the robot in a window, standing still or walking on commands from the keyboard."""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from asimov_gym.rendering.backends import environment, has_display, headless_backend, install_line, probe

if TYPE_CHECKING:
    from asimov_gym.policy import PolicyRunner

STEP_LINEAR = 0.1
"""Change of the velocity command for each key press, m/s."""
STEP_YAW = 0.2
"""The same for the yaw rate, rad/s."""
STANDING_TIME = 3.0
"""Simulated seconds from the STAND command until the robot is asked to walk: its ramp, and a little to settle."""
FRAME = 0.02
"""Simulated seconds between pictures."""

# Key codes of GLFW, which is not imported where there is no window.
_ENTER, _RIGHT, _LEFT, _DOWN, _UP, _PAGE_UP, _PAGE_DOWN, _END = 257, 262, 263, 264, 265, 266, 267, 269
KEYS = {
    _UP: (STEP_LINEAR, 0.0, 0.0),
    _DOWN: (-STEP_LINEAR, 0.0, 0.0),
    _PAGE_UP: (0.0, STEP_LINEAR, 0.0),
    _PAGE_DOWN: (0.0, -STEP_LINEAR, 0.0),
    _LEFT: (0.0, 0.0, STEP_YAW),
    _RIGHT: (0.0, 0.0, -STEP_YAW),
}
"""Change of (vx, vy, wz) by key."""
KEY_HELP = "up/down: forward/back   page up/down: left/right   left/right: turn   end: stop   enter: stand up again"


@dataclass(frozen=True)
class View:
    """Open the robot in a window. With a policy it walks on commands from the keyboard.

    Exit code 0 when the window was closed, 1 for a policy that cannot be used, 2 where no window can be opened.
    """

    policy: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY|RUN]")] = None
    """An ONNX policy, or the folder of a training run. Without it the robot stands still."""
    frame: Path | None = None
    """Write one picture of the standing robot to this PNG file, without a window."""

    def run(self) -> int:
        """Show the robot."""
        if self.frame is not None:
            return self._draw(self.frame)
        try:
            runner = None if self.policy is None else _load(self.policy)
        except (FileNotFoundError, ValueError) as error:
            print(f"asimov view: {error}", file=sys.stderr)
            return 1
        reason = no_window_reason()
        if reason:
            print(f"asimov view: {reason}", file=sys.stderr)
            return 2
        try:
            if runner is None:
                _stand()
            else:
                _walk(runner)
        except RuntimeError as error:  # the viewer's own refusal, such as a missing launcher on macOS
            print(f"asimov view: {error}", file=sys.stderr)
            return 2
        return 0

    def _draw(self, path: Path) -> int:
        if self.policy is not None:
            print("asimov view: --frame shows the standing robot; leave the policy out", file=sys.stderr)
            return 2
        backend = headless_backend()
        if backend is None:
            print(f"asimov view: {install_line()}", file=sys.stderr)
            return 2
        command = [sys.executable, "-m", "asimov_gym.cli.frame", str(path)]
        done = subprocess.run(command, env=environment(backend), check=False)
        if done.returncode == 0:
            print(f"{path} ({backend})")
        return 0 if done.returncode == 0 else 1


def policy_file(path: Path) -> Path:
    """The ONNX file that a path given by a person means: the file itself, or `policy.onnx` of a run folder.

    Raises:
        FileNotFoundError: nothing is there; says what to do about a run without an exported policy.
    """
    if path.is_dir():
        file = path / "policy.onnx"
        if not file.is_file():
            raise FileNotFoundError(f"{path} holds no policy.onnx; make it with: python -m train export {path}")
        return file
    if not path.is_file():
        raise FileNotFoundError(f"there is no policy or run folder {path}")
    return path


def no_window_reason() -> str:
    """Why no window can be opened here; empty if one can."""
    if sys.platform == "darwin":
        return ""  # launch_passive says itself that it wants mjpython
    if sys.platform.startswith("linux") and not has_display():
        return "no display (DISPLAY and WAYLAND_DISPLAY are unset); --frame FILE.png draws a picture without one"
    window = probe("glfw")
    return "" if window.works else f"the display cannot be drawn on ({window.detail})"


def changed_command(command: tuple[float, float, float], key: int) -> tuple[float, float, float]:
    """Velocity command (vx, vy, wz) after a key press; keys that mean nothing leave it as it is."""
    if key == _END:
        return (0.0, 0.0, 0.0)
    change = KEYS.get(key, (0.0, 0.0, 0.0))
    vx, vy, wz = (round(value + step, 3) for value, step in zip(command, change, strict=True))
    return (vx, vy, wz)


def _load(path: Path) -> PolicyRunner:
    from asimov_gym.policy import load_policy

    return load_policy(policy_file(path))


def follow(viewer: Any, model: Any) -> None:
    """Let the viewer's camera go with the robot, seen whole from its front right; the mouse can still turn it."""
    import mujoco

    viewer.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    viewer.cam.trackbodyid = model.body("pelvis_link").id
    viewer.cam.distance, viewer.cam.azimuth, viewer.cam.elevation = 2.6, 130.0, -10.0


def _stand() -> None:
    """Hold the standing pose until the window is closed."""
    import mujoco
    import mujoco.viewer

    from asimov_gym.physics import compile_model

    model = compile_model("evaluation")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    with mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False) as viewer:
        follow(viewer, model)
        while viewer.is_running():
            began = time.perf_counter()
            for _ in range(round(FRAME / model.opt.timestep)):
                mujoco.mj_step(model, data)
            viewer.sync()
            time.sleep(max(0.0, FRAME - (time.perf_counter() - began)))


def _walk(policy: PolicyRunner) -> None:
    """Walk on keyboard commands until the window is closed. They go through the interface, as the demo's do."""
    import mujoco
    import mujoco.viewer

    from asimov_gym.edge import SimulatedRobot, connect
    from asimov_gym.edge.wire import cloud_pb2

    keys: queue.SimpleQueue[int] = queue.SimpleQueue()
    robot = SimulatedRobot(policy)
    model = robot.physics.model
    data = mujoco.MjData(model)
    command = (0.0, 0.0, 0.0)
    print(KEY_HELP)
    with (
        connect(robot, "keyboard") as session,
        mujoco.viewer.launch_passive(
            model, data, key_callback=keys.put, show_left_ui=False, show_right_ui=False
        ) as viewer,
    ):
        follow(viewer, model)
        session.stand()
        ready = STANDING_TIME
        while viewer.is_running():
            began = time.perf_counter()
            while not keys.empty():
                key = keys.get()
                changed = changed_command(command, key)
                if key == _ENTER:
                    robot.restart()
                    session.stand()
                    command, ready = (0.0, 0.0, 0.0), STANDING_TIME
                elif changed != command and ready <= 0.0:
                    command = changed
                    session.velocity(*command)
                    print("vx {:+.1f} m/s  vy {:+.1f} m/s  wz {:+.1f} rad/s".format(*command))
            robot.advance(FRAME)
            if ready > 0.0 and (ready := ready - FRAME) <= 0.0:
                session.velocity(*command)
            if ready <= 0.0 and command != (0.0, 0.0, 0.0) and session.state.get().fw_mode == cloud_pb2.FW_MODE_DAMP:
                command = (0.0, 0.0, 0.0)
                print("the robot is in DAMP; enter stands it up again")
            data.qpos[:] = robot.physics.state().qpos[0]
            mujoco.mj_forward(model, data)
            viewer.sync()
            time.sleep(max(0.0, FRAME - (time.perf_counter() - began)))
