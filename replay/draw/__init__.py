"""Drawn: recordings for Rerun (`recording`), charts as SVG (`charts`), reports as HTML, Markdown, JUnit (`report`)."""
