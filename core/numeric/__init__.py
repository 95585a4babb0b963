"""Arrays and their checks, linear algebra, and networks that OpenCV runs."""
