"""The daemon behind `faultline run`: one loop that listens, decides, remembers and answers."""
