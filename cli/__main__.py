"""`python -m facemime.cli`."""

from .entry import start

start()
