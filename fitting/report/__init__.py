"""Output of a fit: tables, Markdown, pictures."""
