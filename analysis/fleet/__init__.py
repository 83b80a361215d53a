"""Many vehicles: the same commands over folders of recordings, on the cores of a machine or of a cluster."""
