"""The manual: pages of Markdown, and reference pages generated from code, both as text for a terminal."""
