"""The pure core: signals, samples, residuals, decisions, isolation. No file, socket, clock or log."""
