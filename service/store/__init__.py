"""What was told is kept: it survives the process, and a power cut."""
