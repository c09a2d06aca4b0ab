"""What a run leaves behind: its recording, how it is replayed, scored and learned from."""

from renet.deploy.recording.recorder import read_recording

__all__ = ["read_recording"]
