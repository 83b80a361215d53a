"""What was found, told: document, page, pictures, summary, terminal."""
