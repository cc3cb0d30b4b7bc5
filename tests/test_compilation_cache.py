"""The compilation cache is private, is JAX's own, and is off until somebody asks for it."""

import os
import subprocess
import sys

import pytest

import jaxrb as rb
from jaxrb.errors import InvalidInput

_PROGRAM = """
import sys, jax, jaxrb as rb
found = []
jax.monitoring.register_event_listener(lambda event, **_: found.append(event))
before = jax.config.jax_compilation_cache_dir
rb.Scene(rb.Body(1.0, 1.0))
assert jax.config.jax_compilation_cache_dir == before
jax.jit(lambda x: x + 1)(1.0)  # a process that has compiled already finds the cache too
folder = rb.enable_compilation_cache(sys.argv[1])
assert str(folder) == jax.config.jax_compilation_cache_dir
scene = rb.Scene(rb.Body(1.0, 1.0))
rb.step(scene, scene.state())
hits = sum("cache_hits" in event for event in found)
print(hits, sum("cache_misses" in event for event in found))
"""

posix = pytest.mark.skipif(os.name != "posix", reason="owners and modes are POSIX's")


@pytest.mark.skipif(
    bool(os.environ.get("JAX_COMPILATION_CACHE_DIR")), reason="this process has a cache of its own"
)
def test_a_second_process_finds_the_programs_of_the_first(tmp_path):
    command = [sys.executable, "-c", _PROGRAM, str(tmp_path / "new" / "cache")]
    runs = [subprocess.run(command, capture_output=True, text=True, check=False) for _ in range(2)]
    assert not any(run.returncode for run in runs), runs[-1].stderr
    (hits, misses), (later_hits, later_misses) = (map(int, run.stdout.split()) for run in runs)
    assert hits == 0
    assert misses > 0
    assert later_hits > 0
    assert later_misses == 0


@posix
def test_what_is_made_is_private_and_what_others_can_change_is_refused(tmp_path, restored):
    old = os.umask(0o002)
    try:
        folder = rb.enable_compilation_cache(tmp_path / "a" / "b")
    finally:
        os.umask(old)
    assert [oct(path.stat().st_mode & 0o777) for path in (folder, folder.parent)] == ["0o700", "0o700"]
    folder.chmod(0o770)
    with pytest.raises(InvalidInput, match=r"mode 0770: others can write to it.*chmod 700"):
        rb.enable_compilation_cache(folder)
    folder.chmod(0o700)
    folder.parent.chmod(0o777)
    with pytest.raises(InvalidInput, match="can be changed by others"):
        rb.enable_compilation_cache(folder)
    folder.parent.chmod(0o1777)  # as /tmp: nobody can rename what is not his own
    assert rb.enable_compilation_cache(folder) == folder


@posix
def test_a_link_is_judged_by_what_it_points_to(tmp_path, restored):
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    (tmp_path / "link").symlink_to(open_to_all)
    with pytest.raises(InvalidInput, match=r"folder .*open has mode 0777"):
        rb.enable_compilation_cache(tmp_path / "link")


def test_a_file_is_refused_and_the_default_lies_in_the_users_cache(tmp_path, monkeypatch, restored):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match=r"file: Not a directory; name one"):
        rb.enable_compilation_cache(tmp_path / "file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert rb.enable_compilation_cache() == tmp_path / "cache" / "jaxrb" / "compiled"


@pytest.fixture
def restored():
    """Puts JAX's settings back."""
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    names = (
        "jax_compilation_cache_dir",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: getattr(jax.config, name) for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
