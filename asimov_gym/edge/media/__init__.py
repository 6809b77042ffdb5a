"""What the robot sees, hears and says, free of any transport.

| module | what |
|---|---|
| `video` | pictures from the cameras (drawn by `asimov_gym.rendering.camera_process`) |
| `microphone` | frames of sound by the wall clock; the sounds are in `sounds` |
| `speaker` | what clients send, in a WAV file |

Sources hand frames with their edge wall-clock time to whoever subscribes. A transport that has sent one reports that
time to `edge.note_video` or `edge.note_audio`; it also keeps `edge.lanes` true.
"""

from __future__ import annotations

from asimov_gym.edge.media.microphone import AudioFrame, Microphone
from asimov_gym.edge.media.sounds import SAMPLE_RATE, Recording, Silence, Sound, Tone, sound
from asimov_gym.edge.media.speaker import SpeakerFile
from asimov_gym.edge.media.video import VideoSource
from asimov_gym.rendering.camera_process import CameraConfig, Frame

__all__ = [
    "SAMPLE_RATE",
    "AudioFrame",
    "CameraConfig",
    "Frame",
    "Microphone",
    "Recording",
    "Silence",
    "Sound",
    "SpeakerFile",
    "Tone",
    "VideoSource",
    "sound",
]
