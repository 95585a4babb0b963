"""What has a lifetime: threads, what they move, and what is recorded of it."""
