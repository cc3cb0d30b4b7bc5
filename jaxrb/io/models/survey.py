"""Looking through an XML model before MuJoCo sees it: what is in it, what jaxrb has no counterpart of, what is a trap.

Out comes a document of what is understood and nothing else, with includes in place and meshes renumbered, so that the
compiler opens no file and meets nothing that was not looked at. `reader.py` fills it in.
"""

import dataclasses
import os
from pathlib import Path

from jaxrb.errors import InvalidInput
from jaxrb.io.models.vocabulary import Vocabulary


@dataclasses.dataclass(frozen=True)
class Finding:
    """Something in a file that jaxrb leaves out: file and line, the path of elements, and why or what else to do."""

    file: str
    line: int
    path: str
    why: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.path}: {self.why}"


@dataclasses.dataclass(frozen=True)
class Limits:
    """What reading may take: bodies, bytes of XML, bytes of the compiler's memory, seconds."""

    max_bodies: int = 10_000
    max_bytes: int = 2**24
    max_memory: int = 2**31
    timeout: float = 60.0


class Survey:
    """A model looked through (by `reader.surveyed`). `document` is what is left to compile; `meshes` are the files by
    their new names."""

    def __init__(self, file: Path, vocabulary: Vocabulary, limits: Limits, root: Path):
        self.file, self.vocabulary, self.limits = file, vocabulary, limits
        self.root = root.resolve()
        self.unsupported: list[Finding] = []
        self.ignored: list[Finding] = []
        self.meshes: dict[str, Path] = {}
        self.lines: dict[tuple[str, str], tuple[str, int]] = {}
        self.links: set[str] = set()  # of a URDF, and those that are the child of a joint
        self.children: set[str] = set()
        self.folder = ""  # of meshes, from the compiler's settings
        self.wanted: list[tuple[str, str, str]] = []  # meshes: new name, file as written, where
        self.pieces: list[str] = []
        self.open: list[tuple[str, float]] = []  # tags, and how often a replicate unfolds what is in them
        self.bytes, self.bodies, self.elements, self.files = 0, 0.0, 0.0, [file.resolve()]
        self.line = 0  # of what was written so far

    @property
    def document(self) -> str:
        """The XML that is left."""
        return "".join(self.pieces)

    def place(self, tag: str, name: str) -> tuple[str, int]:
        """File and line of the element of that name; the line is 0 where it has none."""
        return self.lines.get((tag, name), (self.file.name, 0))

    def inside(self, text: str, where: str) -> Path:
        """The file that a text names, seen from the model's folder, if it lies in `root`."""
        base = self.file.parent
        if "://" in text and not text.startswith("package://"):
            raise InvalidInput(f"{where}: {text!r} is an address; give a file beside the model")
        path = Path(os.path.normpath(base / text.removeprefix("package://")))
        if text.startswith("package://") and not path.is_file():
            path = Path(os.path.normpath(base / text.removeprefix("package://").partition("/")[2]))
        resolved = path.resolve()
        if Path(text).is_absolute() or not resolved.is_relative_to(self.root):
            raise InvalidInput(
                f"{where}: {text!r} lies outside {self.root}; put it into the model's folder, or give root=…"
            )
        if not resolved.is_file():
            raise InvalidInput(f"{where}: there is no file {text!r} (looked for {resolved})")
        return resolved
