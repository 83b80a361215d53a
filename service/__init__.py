"""Everything that runs on the vehicle: frames in, isolated faults out."""

import os

# onnxruntime keeps a device id in the user's home and looks for its maker's server, unless it is told not to before it
# is loaded: a vehicle tells nobody but its subscribers.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
