"""Suffixes of videos, by which folders are searched and file browsers show files.

Files with other suffixes can be read, too.
"""

VIDEO_SUFFIXES = frozenset(
    {
        *(".mp4", ".m4v", ".mov", ".3gp", ".3g2"),
        *(".mkv", ".webm", ".ogv", ".flv", ".f4v"),
        *(".avi", ".divx", ".wmv", ".asf"),
        *(".mts", ".m2ts", ".ts", ".mpg", ".mpeg", ".vob", ".mxf", ".dv"),
    }
)
"""In lower case; each has been read by OpenCV's FFmpeg."""


def shown_files(*suffixes: str) -> str:
    """Return the filter of a file browser that shows files with these suffixes."""
    return ";".join(f"*{suffix}" for suffix in suffixes)
