"""Exceptions of the package; all are subclasses of `veiloc.Error`.

Messages name the problem and the remedy. They never contain keypoints, descriptors or pixels.
"""


class Error(Exception):
    """Base class of all errors of veiloc."""


class InputError(Error, ValueError):
    """An argument has the wrong shape, an unknown name or an impossible value."""


class ImageError(Error):
    """An image cannot be read or used, or no features were found in it."""


class MapError(Error):
    """A map or a model cannot be read, built, changed or written."""


class QueryError(Error):
    """The bytes are not a sealed query, profile, pack or answer, or a profile requests more than the device sends."""


class WrongProfileError(QueryError):
    """The query was sealed for another map, or for an older state of this one: fetch the profile or pack, and seal again."""


class NotThisPlaceError(Error):
    """Hardly anything in the image is of the place whose pack the device has: point the camera at the place."""


class NotLocalizedError(Error):
    """The correspondences or the query support no pose."""


class ServiceError(Error):
    """A service refused the request, cannot be reached, or sent an answer that cannot be read."""


class BusyError(ServiceError):
    """The service is busy: send the same bytes again after `retry_after` seconds (`None`: the service gave no time)."""

    retry_after: "float | None" = None


class RefusedError(ServiceError):
    """The service refused the request: `status` is the HTTP status, `name` the error name (`unknown-map`, `token`, ...)."""

    status: int = 0
    name: str = ""
