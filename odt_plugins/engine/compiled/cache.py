"""Machine code on disk that goes with the source of all kernels.

numba keeps a kernel for as long as the file stays as it is in which that kernel stands. The kernels
of other files that it calls are part of its machine code, though: where one of those changes, as
in a working copy that is updated in place, the old code would go on being used.
"""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path
from typing import Any


def source_stamp(folder: Path) -> str:
    """Short hash of the files in a folder, and below, in which kernels stand."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        # An editor may leave links that lead nowhere.
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            if b"kernel" in text:
                digest.update(hashlib.sha256(text).digest())
    return digest.hexdigest()[:12]


def keep_by(stamp: str, dispatcher: Any) -> None:
    """Keep a cached kernel under a name of its own for every stamp, as long as there is room.

    Processes with other sources then never read or write the same file. On a full disk a kernel
    is compiled in every process. A numba that caches in a way unknown here goes on as it does.
    Code that is found needs nothing of what numba imports for compiling, half a second of work.
    """
    with contextlib.suppress(ImportError, AttributeError, TypeError):
        from numba.core.caching import IndexDataCacheFile
        from numba.core.runtime.nrt import rtsys

        cache = dispatcher._cache
        kept, locator, save = cache._impl, cache._impl.locator, cache.save_overload

        def save_where_there_is_room(signature: Any, data: Any) -> None:
            with contextlib.suppress(OSError):
                save(signature, data)

        load, guard = cache._load_overload, cache._guard_against_spurious_io_errors

        def load_alone(signature: Any, context: Any) -> Any:
            rtsys.initialize(context)
            with guard():
                return load(signature, context)

        cache._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            cache_path=locator.get_cache_path(), filename_base=f"{kept.filename_base}.{stamp}",
            source_stamp=locator.get_source_stamp(),
        )
        cache.save_overload = save_where_there_is_room
        cache.load_overload = load_alone
