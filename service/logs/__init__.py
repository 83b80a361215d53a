"""Logs and recordings: salvaging readers, and the recording folder's description."""

from service.logs.formats import read_log
from service.logs.log import Log, open_log
from service.logs.recording import Recording, load_recording
from service.logs.report import Frame, LogError, LogReport

__all__ = ["Frame", "Log", "LogError", "LogReport", "Recording", "load_recording", "open_log", "read_log"]
