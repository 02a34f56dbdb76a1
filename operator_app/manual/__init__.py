"""The manual: pages of Markdown, reference pages made by code when they are read, both as text for a terminal."""
