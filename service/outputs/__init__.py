"""Outputs: event socket, control socket and the system's journal."""
