"""Controls of a character's own rig: which there are, what each does to the face, and setting them."""
