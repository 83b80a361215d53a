"""Native code of a bundle's graphs, for many hours of logs: made on a workstation, never on the vehicle."""
