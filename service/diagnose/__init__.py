"""`faultline diagnose`: a bundle run over logs, and what was seen tick by tick."""
