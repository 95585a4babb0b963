"""Images, videos and sound: import and export."""
