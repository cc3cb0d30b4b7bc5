"""Compiled programs kept on disk, so that the next process need not compile them again."""

import errno
import os
import stat
from pathlib import Path

from jaxrb.errors import InvalidInput


def enable_compilation_cache(folder: str | os.PathLike | None = None) -> Path:
    """Keep compiled programs in a folder, and find them there in later processes; returns the folder.

    This is JAX's own persistent cache, switched on for the whole process: it sets `jax_compilation_cache_dir` to the
    folder and lowers `jax_persistent_cache_min_compile_time_secs` and `jax_persistent_cache_min_entry_size_bytes` so
    that the small programs of jaxrb are kept too. Nothing in jaxrb calls it but you. Call it before the first run.
    Whoever can write to the folder can make this process run what he likes, hence the checks. Delete the folder
    whenever you like; nothing else clears it.

    Args:
        folder: by default `jaxrb/compiled` in the user's cache directory (`$XDG_CACHE_HOME`, else `~/.cache`). It is
            made if it is missing, for its owner alone (mode 0700).

    Raises:
        InvalidInput: the folder is not yours, others can write to it or replace it, or it cannot be made.
    """
    place = Path(folder).expanduser().absolute() if folder is not None else _default()
    try:
        for missing in reversed([part for part in (place, *place.parents) if not part.exists()]):
            missing.mkdir(
                mode=0o700, exist_ok=True
            )  # parents=True would make them as open as the umask lets it
        place = place.resolve(strict=True)
        if not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    except OSError as error:
        raise InvalidInput(
            f"enable_compilation_cache: folder {place}: {error.strerror}; name one that you can write"
        ) from error
    if os.name == "posix":
        _check_private(place)

    import jax
    from jax.experimental.compilation_cache.compilation_cache import reset_cache

    jax.config.update("jax_compilation_cache_dir", str(place))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # A process that has compiled already has looked for a cache, found none, and would not look again.
    reset_cache()
    return place


def _default() -> Path:
    root = os.environ.get("XDG_CACHE_HOME", "")
    # The standard says that a relative path there is to be ignored.
    return (Path(root) if os.path.isabs(root) else Path.home() / ".cache") / "jaxrb" / "compiled"


def _check_private(place: Path) -> None:
    """Refuse a folder that another user can write to, or can put another in the place of."""
    about = place.stat()
    if about.st_uid != os.geteuid():
        raise InvalidInput(
            f"enable_compilation_cache: folder {place} belongs to user {about.st_uid}, not to you; name one of your own"
        )
    if about.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise InvalidInput(
            f"enable_compilation_cache: folder {place} has mode {stat.S_IMODE(about.st_mode):04o}: others can write "
            f"to it, and so choose what you run; chmod 700 {place}, or name another"
        )
    for above in place.parents:
        over = above.stat()
        others = over.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not over.st_mode & stat.S_ISVTX
        if others or over.st_uid not in (0, os.geteuid()):
            raise InvalidInput(
                f"enable_compilation_cache: folder {above}, above {place}, can be changed by others, who could put "
                "another folder in its place; name one below your home directory"
            )
