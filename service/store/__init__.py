"""Store of records, which survives the process and a power cut."""
