"""A benchmark's results as one HTML file that opens offline."""

from .page import page, write

__all__ = ["page", "write"]
