"""Sets thresholds, and what ranks the faults, from fault-free recordings."""
