"""Logs and recordings: salvaging readers, and the recording folder's description."""

from faultline.service.logs.log import Log
from faultline.service.logs.opening import open_any, open_log, read_log
from faultline.service.logs.recording import Recording, load_recording
from faultline.service.logs.report import Frame, LogError, LogReport

__all__ = ["Frame", "Log", "LogError", "LogReport", "Recording", "load_recording", "open_any", "open_log", "read_log"]
