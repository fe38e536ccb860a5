"""A screen as one page that a browser opens by itself: the engine as WebAssembly, and the state."""

from vibroscreen.explorer.page import page_of, write_page

__all__ = ["page_of", "write_page"]
