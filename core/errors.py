"""The errors that a user can cause. Each message is one sentence on what is wrong and one on what to do."""


class FacemimeError(Exception):
    """Base of every expected error: shown to the user as its message, without a traceback."""


class SourceError(FacemimeError):
    """A camera, video, image or take cannot be read."""


class ModelError(FacemimeError):
    """A file of assets is missing, damaged, of another version, or not ours."""


class HeadError(FacemimeError):
    """A mesh lacks what driving it needs: landmarks, regions, or enough distinct control points."""


class OutputError(FacemimeError):
    """A result cannot be written where the user asked for it."""
