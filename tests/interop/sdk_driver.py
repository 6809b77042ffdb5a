"""Runs under the public client's own interpreter: takes calls as lines of JSON, makes them, answers with lines of JSON.

    {"call": "stand", "arguments": {}}  ->  {"result": ..., "seconds": 0.5}  or  {"error": "WaitTimeoutError", ...}

Nothing of this project is imported here: what connects is the published package alone.
"""

from __future__ import annotations

import collections
import json
import logging
import struct
import sys
import time
from typing import Any

from menlo.asimov import (  # pyright: ignore[reportMissingImports]
    ConnectionConfig,
    LiveKitConfig,
    ManagerConfig,
    Robot,
    State,
    UdpConfig,
)


class LogKeeper(logging.Handler):
    """Keeps the client's own log lines."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def described(state: State) -> dict[str, Any]:
    return {
        "mode": state.mode.name,
        "sequence": state.sequence,
        "fw_timestamp_us": state.fw_timestamp_us,
        "edge_timestamp_us": state.edge_timestamp_us,
        "protocol_version": state.protocol_version,
        "names": [joint.name for joint in state.joints],
        "positions": list(state.joint_pos),
        "temperatures": [joint.temp for joint in state.joints],
        "gravity": state.gravity,
        "upright": state.upright,
        "error_flags": state.error_flags,
        "faulted": state.faulted,
        "alerts": [alert.name for alert in state.alerts],
        "battery": None if state.battery is None else state.battery.soc_percent,
    }


class Driver:
    """The calls a test can make."""

    def __init__(self) -> None:
        self.robot: Robot | None = None
        self.samples: collections.deque[tuple[float, int, int, bool]] = collections.deque(maxlen=100_000)
        self.modes: list[tuple[str, str]] = []
        self.alerts: list[tuple[float, str, str]] = []
        self.log = LogKeeper()
        logging.getLogger("menlo").addHandler(self.log)
        logging.getLogger("menlo").setLevel(logging.INFO)

    def connect_udp(self, host: str, command_port: int, state_port: int, version_port: int) -> dict[str, Any]:
        config = UdpConfig(
            host, command_port=command_port, state_bind=("127.0.0.1", state_port), version_port=version_port
        )
        return self._connect(ConnectionConfig(udp=config), "udp")

    def connect_livekit(self, url: str, room: str, token: str, media_timeout: float) -> dict[str, Any]:
        config = LiveKitConfig(url, room, token)
        return self._connect(ConnectionConfig(livekit=config), "livekit", media_timeout=media_timeout)

    def connect_hybrid(
        self, host: str, command_port: int, state_port: int, version_port: int, manager: str, credential: str
    ) -> dict[str, Any]:
        """Commands and state over UDP, pictures and sound over the room that the manager's token opens."""
        udp = UdpConfig(
            host, command_port=command_port, state_bind=("127.0.0.1", state_port), version_port=version_port
        )
        config = ConnectionConfig(udp=udp, livekit=ManagerConfig(manager, credential))
        return self._connect(config, "hybrid", media_timeout=10.0)

    def _connect(self, config: ConnectionConfig, mode: str, **options: Any) -> dict[str, Any]:
        self.robot = Robot(config)
        self.robot.on_state = lambda s: self.samples.append(
            (time.monotonic(), s.sequence, s.fw_timestamp_us, s.gravity is not None and len(s.joints) == 25)
        )
        self.robot.on_mode_change = lambda old, new: self.modes.append((old.name, new.name))
        self.robot.on_alert = lambda alert, what: self.alerts.append((time.monotonic(), alert.name, what))
        self.robot.connect(mode, timeout=5.0, **options)
        return {"dof": self.robot.info.dof, "capabilities": sorted(self.robot.info.capabilities)}

    def look_and_listen(self, seconds: float) -> dict[str, Any]:
        """What camera and microphone bring in a while."""
        clip = self.robot.camera.capture_clip(seconds)
        samples = [sample for chunk in clip.audio for (sample,) in struct.iter_unpack("<h", chunk.data)]
        return {
            "pictures": len(clip.frames),
            "size": [clip.frames[-1].width, clip.frames[-1].height],
            "colours": len(set(clip.frames[-1].data[:: 97 * 3])),
            "rate": clip.audio[-1].sample_rate_hz,
            "channels": clip.audio[-1].channels,
            "seconds_of_sound": clip.duration_s,
            "loudest": max(samples),
        }

    def speak(self, seconds: float, level: int) -> None:
        """Play a square wave on the robot, as fast as it sounds."""
        period = [level] * 24 + [-level] * 24
        tenth = struct.pack("<4800h", *(period * 100))
        for _ in range(round(seconds * 10)):
            self.robot.speaker.play_pcm(tenth, sample_rate_hz=48_000)
            time.sleep(0.1)

    def state(self) -> dict[str, Any]:
        return described(self.robot.get_state())

    def armed(self) -> bool | None:
        return self.robot.armed

    def problems(self, action: str) -> list[str]:
        return [problem.code for problem in self.robot.preflight(action).problems]

    def stream(self) -> dict[str, Any]:
        """What has come since the last call: times, counters, and whether each sample was whole."""
        taken = [self.samples.popleft() for _ in range(len(self.samples))]
        return {
            "times": [one[0] for one in taken],
            "sequences": [one[1] for one in taken],
            "clocks": [one[2] for one in taken],
            "whole": all(one[3] for one in taken),
        }

    def history(self) -> dict[str, Any]:
        return {"modes": self.modes, "alerts": self.alerts, "log": self.log.lines}

    def wait_for(self, seconds: float) -> None:
        time.sleep(seconds)

    def wait_until_mode(self, mode: str, timeout: float) -> dict[str, Any]:
        return described(self.robot.wait_until(lambda s: s.mode.name == mode, timeout=timeout))

    def __getattr__(self, verb: str) -> Any:
        """Every other call is the robot's own; what it returns about sending is not of interest here."""
        if verb.startswith("_"):
            raise AttributeError(verb)
        method = getattr(self.robot, verb)

        def call(**arguments: Any) -> dict[str, Any] | None:
            sent = method(**arguments)
            return None if sent is None else {"sequence": sent.sequence, "clamped": sent.clamped}

        return call


def main() -> None:
    driver = Driver()
    for line in sys.stdin:
        request = json.loads(line)
        began = time.monotonic()
        try:
            reply: dict[str, Any] = {"result": getattr(driver, request["call"])(**request["arguments"])}
        except Exception as problem:
            reply = {"error": type(problem).__name__, "message": str(problem)}
        reply["seconds"] = time.monotonic() - began
        print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    main()
