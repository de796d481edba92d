"""The HTML report: page, charts, pictures, and what a job or a comparison puts into it."""
