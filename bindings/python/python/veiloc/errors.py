"""What can go wrong, as exceptions: all of them are `veiloc.Error`.

Messages name what was wrong and the remedy; none holds anything of an image's or a query's content.
"""


class Error(Exception):
    """Anything that veiloc refuses or cannot do."""


class InputError(Error, ValueError):
    """An argument has the wrong shape, an unknown name or an impossible value."""


class ImageError(Error):
    """A file or an array is no image that can be used, or has no features to send."""


class MapError(Error):
    """A map or a model cannot be read, built, changed or written."""


class QueryError(Error):
    """Bytes that are no sealed query, profile or answer, or a profile that asks for more than the device gives."""


class WrongProfileError(QueryError):
    """The query was sealed for another map, or for an older state of this one: fetch the profile and seal again."""


class NotLocalizedError(Error):
    """There is no pose that the correspondences or the query support."""


class ServiceError(Error):
    """A service refused, could not be reached, or answered nothing that can be understood."""


class BusyError(ServiceError):
    """The service is busy: ask again with the same bytes after `retry_after` seconds (`None`: it did not say)."""

    retry_after: "float | None" = None


class RefusedError(ServiceError):
    """The service refused the request: `status` is HTTP's, `name` the problem's name (`unknown-map`, `token`, ...)."""

    status: int = 0
    name: str = ""
