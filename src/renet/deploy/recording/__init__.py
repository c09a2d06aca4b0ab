"""Recordings of runs: written, read, replayed, scored, and learned from."""

from renet.deploy.recording.reader import read_recording

__all__ = ["read_recording"]
