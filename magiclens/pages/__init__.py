"""Parts that all pages share: one jinja2 environment, one base template, one style sheet, pictures inside a page."""
