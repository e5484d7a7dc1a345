"""Reports of a run and of a comparison: terminal, HTML, Markdown, JUnit."""
