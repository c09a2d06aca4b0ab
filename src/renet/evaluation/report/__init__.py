"""Figures, videos and the HTML page."""
