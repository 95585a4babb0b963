"""Many clips: each puppeted by a process of its own, here or on other machines, and one report of all."""
