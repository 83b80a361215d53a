"""Grey-box RNN residual generators: networks whose structure is a test's computational graph, trained from recordings.

What it writes is a folder of networks (`analysis.networks`); thresholds are `faultline tune`'s.
"""
