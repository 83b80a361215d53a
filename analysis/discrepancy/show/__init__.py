"""Reports of a discovery: document, page, pictures, summary, terminal."""
