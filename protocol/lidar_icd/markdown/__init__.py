"""The interface document in Markdown."""
