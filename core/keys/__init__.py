"""Shape keys of expressions: making them, grading them, and reading a face that they move."""
