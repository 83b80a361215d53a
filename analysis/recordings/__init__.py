"""Recordings offline: a bench recording made instrumented, and a log seen as the vehicle sees it."""
