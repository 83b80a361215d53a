"""The DBC files of faultline: data only (see README.md beside this file)."""
