"""The manual: Markdown pages, and reference pages generated from code; both can be shown as text in a terminal."""
