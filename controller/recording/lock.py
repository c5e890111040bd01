"""One writer at a time: the lock on a file or folder of a run."""

from __future__ import annotations


def lock(descriptor: int) -> None:
    """Lock what is open for this program alone, until it is closed.

    Raises:
        OSError: another program holds it, or the system or the file system has no such locks.
    """
    try:
        import fcntl
    except ImportError:  # Windows, where runs are read and none is made
        raise OSError("this system has no flock") from None
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
