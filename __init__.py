"""Facemime: live face puppetry for Blender."""


def register() -> None:
    """Register the extension."""
    from . import registration

    registration.register()


def unregister() -> None:
    """Unregister the extension."""
    from . import registration

    registration.unregister()
