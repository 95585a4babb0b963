"""Motion on heads: shown live by one shape key, or baked to keys, caches and curves."""
