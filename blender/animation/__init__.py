"""Motion of heads: displayed live by one shape key, or baked to shape keys, caches and F-Curves."""
