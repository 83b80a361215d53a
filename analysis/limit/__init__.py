"""The limit computes which faults a drive can show at best, before there is any faulty data."""
