"""Errors that a user can cause. Their messages say what happened and what to do."""


class FacemimeError(Exception):
    """Base class of expected errors, which are shown as a message without a traceback."""


class SourceError(FacemimeError):
    """A camera, video, image or take cannot be read."""


class ModelError(FacemimeError):
    """A file of the assets is missing, damaged, of a different version, or not one of Facemime's."""


class HeadError(FacemimeError):
    """A mesh cannot be driven: it lacks landmarks, regions, or enough distinct control points."""


class OutputError(FacemimeError):
    """A result cannot be written to the requested location."""
