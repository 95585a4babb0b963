"""A job: which face moves which head, how, and what comes of it; a plain value, whoever asks for it."""
