"""The systems that come with the program: data only, a folder each (docs/models.md)."""
