"""Times as people read them."""


def timecode(seconds: float) -> str:
    """Format a time as minutes and seconds, such as 1:05.2; tenths are rounded, and negative times have a sign."""
    tenths = round(10.0 * abs(seconds))
    sign = "-" if seconds < 0.0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"
