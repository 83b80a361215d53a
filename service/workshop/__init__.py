"""The diagnosis test of a workshop (thesis 8.2.2): an active test cycle, followed by what the service tells of it."""
