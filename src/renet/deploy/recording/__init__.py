"""Recordings of runs: writing, reading, replay, scores, and calibration from them."""

from renet.deploy.recording.reader import read_recording

__all__ = ["read_recording"]
