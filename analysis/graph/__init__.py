"""From a test to a graph that runs: flow networks, the implicit step, and ONNX."""
