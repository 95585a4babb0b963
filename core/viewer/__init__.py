"""A page that shows driven heads in a browser, and the server that streams to it (viewer.md)."""
