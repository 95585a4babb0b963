"""What makes a mesh a head: landmarks, regions, lids, lips, eyeballs; the built-in head, and heads that others made."""
