"""What people see of a fit: tables, Markdown, pictures."""
