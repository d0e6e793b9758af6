"""What all pages share: one base template, one style sheet, pictures inside a page."""
