"""Reading an XML model for a survey. Expat streams: nothing is held but the open elements."""

import math
import os
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from jaxrb.errors import InvalidInput, JaxrbError, LimitExceeded
from jaxrb.io.models.survey import Finding, Limits, Survey
from jaxrb.io.models.vocabulary import Rule, Vocabulary

MAX_DEPTH, MAX_INCLUDES, MAX_CELLS = 64, 100, 10_000_000
_ELEMENTS_A_BODY = 20  # how many elements a file may unfold to, for each body that is allowed


def surveyed(file: Path, vocabulary: Vocabulary, limits: Limits, root: Path) -> Survey:
    """Look through a model whose files must lie in `root`.

    Raises:
        InvalidInput: a document type or entity, a file outside the folder, text where numbers belong, a name that is
            there twice, XML that is none. LimitExceeded: depth, size, or a count beyond a limit.
    """
    survey = Survey(file, vocabulary, limits, root)
    _Reader(survey, file, inner=False).read()
    for name, text, where in survey.wanted:
        survey.meshes[name] = survey.inside(os.path.join(survey.folder, text), where)
    return survey


class _Reader:
    """One file of a model; an included one goes on with the survey of the file that includes it."""

    def __init__(self, survey: Survey, file: Path, inner: bool):
        self.survey, self.file = survey, file
        self.inner = inner
        self.depth = len(survey.open)
        self.actions: list[str] = []  # of the open elements of this file: "kept", "through", "left"
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.StartDoctypeDeclHandler = self.refuse_doctype

    def read(self) -> None:
        survey = self.survey
        try:
            survey.bytes += self.file.stat().st_size
            if survey.bytes > survey.limits.max_bytes:
                raise LimitExceeded(
                    f"{self.file}: {survey.bytes} bytes of XML are more than max_bytes={survey.limits.max_bytes}"
                )
            data = self.file.read_bytes()
        except OSError as error:
            raise JaxrbError(f"{self.file}: could not be read ({error})") from error
        try:
            self.parser.Parse(data, True)
        except expat.ExpatError as error:
            raise InvalidInput(f"{self.file.name}:{error.lineno}: this is no XML: {error}") from error

    @property
    def where(self) -> str:
        return f"{self.file.name}:{self.parser.CurrentLineNumber}"

    def refuse_doctype(self, *_: object) -> None:
        raise InvalidInput(
            f"{self.where}: a document type is not read: its entities may name other files and unfold without end; "
            "write the values out and delete the DOCTYPE"
        )

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        survey = self.survey
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise LimitExceeded(
                f"{self.where}: elements are nested deeper than {MAX_DEPTH}; flatten the model"
            )
        times = survey.open[-1][1] if survey.open else 1.0
        self.count(tag, times)
        if self.actions and self.actions[-1] == "left":
            self.actions.append("left")
        elif self.inner and not self.actions:
            self.actions.append(
                "through"
            )  # the root of an included file: its children stand where the include stood
        elif tag == "include" and survey.vocabulary.root == "mujoco":
            self.actions.append("left")
            self.include(attributes.get("file", ""))
        elif not self.understood(tag, attributes) or (kept := self.kept(tag, attributes)) is None:
            self.actions.append("left")
        else:
            self.actions.append("kept")
            if tag == "replicate":
                times *= max(1.0, float(kept.get("count", "1").split()[0]))
            survey.open.append((tag, times))
            told = "".join(f" {name}={quoteattr(value)}" for name, value in kept.items())
            # Each element on the line where it stands, for the compiler's messages.
            gap = 0 if self.inner else self.parser.CurrentLineNumber - 1 - survey.line
            survey.line += max(gap, 0)
            survey.pieces.append(f"{gap * chr(10)}<{tag}{told}>")

    def end(self, tag: str) -> None:
        self.depth -= 1
        if self.actions.pop() == "kept":
            self.survey.open.pop()
            self.survey.pieces.append(f"</{tag}>")

    def count(self, tag: str, times: float) -> None:
        """Add to what the file unfolds to, before anything is unfolded."""
        survey, most = self.survey, self.survey.limits.max_bodies
        survey.elements += times
        survey.bodies += times if tag in ("body", "link") else 0.0
        for number, limit in ((survey.bodies, most), (survey.elements, _ELEMENTS_A_BODY * most)):
            if number > limit:
                what = "bodies" if limit == most else "elements"
                raise LimitExceeded(
                    f"{self.where}: it unfolds to {number:.3g} {what} or more, above {limit} (max_bodies={most}); "
                    "make it smaller or raise that"
                )

    def include(self, name: str) -> None:
        survey = self.survey
        path = survey.inside(name, self.where)
        if path in survey.files:
            raise InvalidInput(f"{self.where}: {name!r} is included a second time, or includes itself")
        if len(survey.files) > MAX_INCLUDES:
            raise LimitExceeded(f"{self.where}: more than {MAX_INCLUDES} files are included")
        survey.files.append(path)
        _Reader(survey, path, inner=True).read()

    def path_of(self, tag: str, attributes: dict[str, str], attribute: str = "") -> str:
        name = attributes.get("name")
        end = f"{tag}[{name}]" if name else tag
        return "/".join(["", *(open_tag for open_tag, _ in self.survey.open), end]) + (
            f"@{attribute}" if attribute else ""
        )

    def tell(self, found: list[Finding], path: str, why: str) -> None:
        found.append(Finding(self.file.name, self.parser.CurrentLineNumber, path, why))

    def understood(self, tag: str, attributes: dict[str, str]) -> bool:
        """Whether the element is one of the vocabulary, where it stands; else it is told."""
        survey, words = self.survey, self.survey.vocabulary
        parent = survey.open[-1][0] if survey.open else ""
        if tag == words.root and not parent:
            return True
        if not parent:
            raise InvalidInput(
                f"{self.where}: the file begins with <{tag}>, not <{words.root}>; is it the right kind?"
            )
        if tag in words.elements and parent in words.elements[tag].parents:
            return True
        path = self.path_of(tag, attributes)
        if tag == "hfield":
            self.check_cells(attributes)
        if parent == "default":
            self.tell(survey.ignored, path, "a default of what is not read")
        elif tag in words.ignored:
            self.tell(survey.ignored, path, words.ignored[tag])
        else:
            self.tell(
                survey.unsupported, path, words.unsupported.get(tag, "jaxrb does not know this element here")
            )
        return False

    def check_cells(self, attributes: dict[str, str]) -> None:
        cells = math.prod(
            self.number("hfield", name, attributes.get(name, "0"))[0] for name in ("nrow", "ncol")
        )
        if cells > MAX_CELLS:
            raise LimitExceeded(f"{self.where}: a height field of {cells:.3g} cells, above {MAX_CELLS}")

    def kept(self, tag: str, attributes: dict[str, str]) -> dict[str, str] | None:
        """The attributes that are understood; None where the element cannot be without one that is not."""
        survey = self.survey
        rules = survey.vocabulary.elements[tag].attributes
        found: dict[str, str] = {}
        for name, value in attributes.items():
            rule = rules.get(name, Rule("only", (), "jaxrb does not know this attribute"))
            path = f"{self.path_of(tag, attributes, name)}={value[:40]!r}"
            if rule.kind == "ignored":
                self.tell(survey.ignored, path, rule.why)
            elif rule.kind in ("only", "needs") and not self.same(value, rule.values):
                self.tell(survey.unsupported, path, rule.why)
                if rule.kind == "needs":
                    return None
            elif rule.kind == "file":
                found[name] = self.renamed(value)
            else:
                if rule.kind == "numbers":
                    self.number(tag, name, value)
                found[name] = value
        self.note(tag, found)
        if tag == "compiler":
            survey.folder = found.pop("meshdir", found.pop("assetdir", survey.folder))
        return found

    def note(self, tag: str, attributes: dict[str, str]) -> None:
        """Where names stand, and that each stands once."""
        survey, name = self.survey, attributes.get("name")
        if tag == "link":
            survey.links.add(name or "")
        if tag == "child":
            survey.children.add(attributes.get("link", ""))
        if name is None or "default" in (open_tag for open_tag, _ in survey.open):
            return
        kind = "joint" if tag == "freejoint" else tag
        if (kind, name) in survey.lines and kind in survey.vocabulary.named:
            file, line = survey.lines[kind, name]
            raise InvalidInput(
                f"{self.where}: a second {kind} has the name {name!r}; the first is at {file}:{line}"
            )
        survey.lines[kind, name] = (self.file.name, self.parser.CurrentLineNumber)

    def renamed(self, value: str) -> str:
        """A name of our own for a file, which cannot lead anywhere."""
        name = f"mesh_{len(self.survey.wanted)}{Path(value).suffix.lower()}"
        self.survey.wanted.append((name, value, self.where))
        return name

    def number(self, tag: str, name: str, value: str) -> list[float]:
        found = []
        for word in value.split():
            try:
                found.append(float(word))
            except ValueError:
                found.append(math.nan)
            if not math.isfinite(found[-1]):
                raise InvalidInput(f"{self.where}: {tag}@{name}: {word[:40]!r} is no finite number")
        if not found:
            raise InvalidInput(f"{self.where}: {tag}@{name} is empty; give its numbers or leave it out")
        return found

    def same(self, value: str, allowed: tuple[str, ...]) -> bool:
        """Whether a value is among the allowed words, or as numbers equal to one of them and then zeros."""
        if value.strip() in allowed:
            return True
        try:
            first, *more = (float(word) for word in value.split())
        except ValueError:
            return False
        return not any(more) and any(_is_number(word) and float(word) == first for word in allowed)


def _is_number(word: str) -> bool:
    return word.replace(".", "", 1).lstrip("-").isdigit()
