"""Sessions: everything that runs for a while, such as live puppets and recordings."""
