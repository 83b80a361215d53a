"""Everything that runs on the vehicle: frames in, isolated faults out."""
