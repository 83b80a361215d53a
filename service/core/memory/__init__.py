"""The fault memory of a system, its debounce counters and its freeze frames."""
